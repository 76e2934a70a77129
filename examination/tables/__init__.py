"""Tables of other loggers: true tables, written in many dialects, imported and judged."""
