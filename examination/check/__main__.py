"""`./bench check NAME [options]`: what the module NAME of this folder checks."""

import sys
from importlib import import_module

sys.exit(import_module(f"examination.check.{sys.argv[1]}").main(sys.argv[2:]))
