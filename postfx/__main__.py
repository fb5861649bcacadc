"""`python -m postfx`."""

import sys

from postfx.cli.main import main

sys.exit(main())
