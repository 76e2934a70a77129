"""The withheld-effect check: a reality of its own, cases made with it, and their scorer."""
