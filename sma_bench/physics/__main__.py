"""python -m sma_bench.physics: compiles what every command needs, once after an installation."""

from sma_bench.physics.simulate import run_once

if __name__ == "__main__":
    run_once()
