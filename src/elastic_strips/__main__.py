"""``python -m elastic_strips``: the command line."""

from elastic_strips.cli import main

if __name__ == "__main__":
    main()
