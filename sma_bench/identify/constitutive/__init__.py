"""E9 on isobaric tests: the whole constitutive law at once."""
