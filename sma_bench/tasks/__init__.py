"""Read, compute, write: what the command line, the services, Python and batches all do."""
