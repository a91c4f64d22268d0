"""``python -m workshop``, in a checkout."""

import sys

from elastic_strips.cli import run_program

if __name__ == "__main__":
    run_program("workshop.cli.group", sys.argv[1:])
