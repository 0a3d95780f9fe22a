"""`python -m garad_golden`."""

import sys

from .cli import main

sys.exit(main())
