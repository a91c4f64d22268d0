"""What this project is measured with, and compared with: ``python -m workshop``. Nothing of the package imports it."""
