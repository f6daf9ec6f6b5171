"""`python -m planrunner`."""

import sys

from planrunner.cli import main

if __name__ == "__main__":
    sys.exit(main())
