"""`python3 -m granumat` is the command `granumat`."""

import sys

from .cli import main

sys.exit(main())
