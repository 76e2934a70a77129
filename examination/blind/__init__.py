"""The withheld-effect check: its own simulator (reality), cases made with it, and their scorer."""
