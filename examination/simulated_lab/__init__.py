"""A laboratory in software: benches drawn at random, their protocols, instruments and bags."""
