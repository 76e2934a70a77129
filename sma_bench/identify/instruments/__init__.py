"""E5 to E8: transitions, stiffness and strain from the instruments' files."""
