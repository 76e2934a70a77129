"""One file a command of `sma-bench`: `add_arguments(parser)` and `run(args) -> exit code`."""
