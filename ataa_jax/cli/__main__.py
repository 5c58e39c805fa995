"""The command line as ``python -m ataa_jax.cli``."""

import sys

from ataa_jax.cli import main

sys.exit(main())
