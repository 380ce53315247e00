"""``python -m modalax``: the command."""

import sys

from modalax.cli import main

sys.exit(main())
