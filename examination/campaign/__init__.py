"""The reliability campaign: what is done to the software, and what it must do then."""
