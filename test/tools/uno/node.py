"""The emulated bench as a process: `serial_bridge` opens its port like that of a real device.

    ./bench python test/tools/uno/node.py --port /tmp/uno [--namespace /bench] [--params FILE]

Temperatures, which the Uno does not measure, are published as `<channel>/temperature` and
`ambient/temperature`, without noise; with `--camera`, those of the wires as
`<channel>/true_temperature`, from which `synthetic_camera` makes its pictures.
"""

import argparse
import contextlib
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import rclpy
from sensor_msgs.msg import Temperature

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from sma_bench.errors import InputError
from sma_bench.hardware.safety import CELSIUS_ZERO
from sma_bench.lifeline import end_with_starter
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.ros.node import READINGS, OverridableNode, start_ros
from uno.emulated_bench import emulated_bench

PERIOD = 0.04
# s; the emulator's thread needs its turn every millisecond.
SWITCH = 1e-4


def main(argv: Sequence[str] | None = None) -> int:
    """Run until SIGINT or SIGTERM; returns 2 after wrong input, or without the tools for an Uno."""
    parser = argparse.ArgumentParser(prog="node.py", description=__doc__)
    parser.add_argument("--port", required=True, help="link to make to the emulated port")
    parser.add_argument("--namespace", default="/bench")
    parser.add_argument("--params", help="what the bench is made of; Table I's wire when absent")
    parser.add_argument("--camera", action="store_true")
    args = parser.parse_args(argv)
    end_with_starter(signal.SIGINT)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.setswitchinterval(SWITCH)
    link = Path(args.port)
    try:
        rig = Parameters.defaults()
        if args.params:
            rig = read_parameters(args.params)
        start_ros(["--ros-args", "-r", f"__ns:={args.namespace}"])
        with emulated_bench(rig) as bench:
            if link.is_symlink():
                link.unlink()
            link.symlink_to(bench.path)
            print(f"port: {link}", flush=True)
            publish(rig, bench.plant.bench, "true_temperature" if args.camera else "temperature")
    except KeyboardInterrupt:
        return 0
    except (InputError, OSError) as error:
        print(f"emulated bench: {error}", file=sys.stderr)
        return 2
    finally:
        with contextlib.suppress(OSError):
            link.unlink(missing_ok=True)
        rclpy.try_shutdown()


def publish(rig: Parameters, bench: object, name: str) -> None:
    """Publish temperatures of wires and air, for ever."""
    node = OverridableNode("emulated_bench")
    places = [*(f"{channel}/{name}" for channel in rig["bench.channels"]), "ambient/temperature"]
    publishers = [node.create_publisher(Temperature, place, READINGS) for place in places]
    while True:
        kelvins = (*bench.temperature_reading, bench.ambient_temperature)
        for place, publisher, kelvin in zip(places, publishers, kelvins, strict=True):
            message = Temperature(temperature=float(kelvin) - CELSIUS_ZERO)
            message.header.stamp = node.get_clock().now().to_msg()
            message.header.frame_id = place.split("/")[0]
            publisher.publish(message)
        time.sleep(PERIOD)


if __name__ == "__main__":
    sys.exit(main())
