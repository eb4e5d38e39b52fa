"""``python -m uqsphere``."""

import sys

from uqsphere.cli import main

sys.exit(main())
