"""`python -m alfmu` is the command `alfmu`."""

import sys

from .cli import main

sys.exit(main())
