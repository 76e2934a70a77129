"""`./bench check NAME [options]`: run the check in module NAME of this folder."""

import sys
from importlib import import_module

sys.exit(import_module(f"examination.check.{sys.argv[1]}").main(sys.argv[2:]))
