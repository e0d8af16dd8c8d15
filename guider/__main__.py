"""`python -m guider` is the command `guider`."""

import sys

from guider.cli import main

sys.exit(main())
