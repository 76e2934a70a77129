"""Memory leaks are found: in a node by the soak's slope, in the recorder within seconds."""

import gc
import time
import tracemalloc

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")
import rclpy  # noqa: E402
from sensor_msgs.msg import BatteryState  # noqa: E402

from examination.campaign.nodes import LIMIT
from sma_bench.nodes.recorder import Recorder  # noqa: E402
from sma_bench.ros.node import READINGS  # noqa: E402

MESSAGES_AN_HOUR = 3600 * 281  # of a wire's bench: 100, 80, 100 and 1 Hz


def test_a_recorder_holds_no_memory_of_a_message(ros_domain, tmp_path, monkeypatch):
    rclpy.init(args=["--ros-args", "-r", "__ns:=/bench", "-p", f"output:={tmp_path / 'bag'}"])
    talker = rclpy.create_node("talker")
    publisher = talker.create_publisher(BatteryState, "/bench/wire/power", READINGS)
    recorder = Recorder()

    def look():
        for timer in recorder.timers:
            timer.callback()

    def held_after(seconds):
        for _ in range(seconds):
            for _ in range(200):
                take(bytes(range(200)))
            look()
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    try:
        end = time.monotonic() + 30.0
        while not publisher.get_subscription_count() and time.monotonic() < end:
            look()
        # Called as by the executor. The soak checks memory of publishers and middleware: their pool
        # of some 100 kB for outgoing texts is renewed for minutes, which is no growth.
        for talks in recorder.publishers:
            monkeypatch.setattr(talks, "publish", lambda message: None)
        (take,) = [s.callback for s in recorder.subscriptions if "power" in s.topic_name]
        held_after(5)
        tracemalloc.start()
        before = held_after(10)
        kept = (held_after(20) - before) / (20 * 200)
    finally:
        tracemalloc.stop()
        recorder.close()
        for node in (recorder, talker):
            node.destroy_node()
        rclpy.shutdown()
    assert MESSAGES_AN_HOUR * kept < 0.5e6 * LIMIT, f"{kept:.1f} bytes a message"
