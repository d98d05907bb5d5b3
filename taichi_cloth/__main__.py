"""`python -m taichi_cloth`."""

import sys

from .cli import main

sys.exit(main())
