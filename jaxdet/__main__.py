"""``python -m jaxdet`` is the command ``jaxdet``."""

import sys

from jaxdet.cli import main

if __name__ == "__main__":
    sys.exit(main())
