"""E1 to E3: resistance, heat transfer and heat capacity from a wire's own record."""
