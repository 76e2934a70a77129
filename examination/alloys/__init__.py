"""Drawn alloys and the tests of them that instruments would write; shares no code with what
identifies them."""
