"""Other people's tables: true ones, written in many dialects, imported, and judged."""
