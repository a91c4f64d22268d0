"""The means of measuring this project and of comparing it: ``python -m workshop``. The package never imports it."""
