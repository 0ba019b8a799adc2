"""`babble` and `python -m services.launcher`."""

import sys

from services.launcher.cli import main

if __name__ == "__main__":
    sys.exit(main())
