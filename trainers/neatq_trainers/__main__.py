"""`python -m neatq_trainers` is the `neatq` command."""

import sys

from neatq_trainers.cli import main

if __name__ == "__main__":
    sys.exit(main())
