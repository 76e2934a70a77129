"""A node with the states of ROS's lifecycle, which `ros2 lifecycle set` and launch files drive.

Its own services say the same in the bench's words; both ways move one state machine.
"""

from collections.abc import Callable

from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

from sma_bench.errors import InputError
from sma_bench.nodes.base import BenchNode

UNCONFIGURED, INACTIVE, ACTIVE = "unconfigured", "inactive", "active"


class ManagedNode(LifecycleNodeMixin, BenchNode):
    """What a kind of node does on its way overrides `configure` to `cleanup`.

    These raise an InputError where it cannot be; the node then stays where it was.
    """

    def __init__(self, name: str) -> None:
        BenchNode.__init__(self, name)
        LifecycleNodeMixin.__init__(self)
        self._refusal = ""

    def configure(self) -> None:
        """Get ready; nothing is driven or written."""

    def activate(self) -> None:
        """Do what the node is for."""

    def deactivate(self) -> None:
        """Leave it: 0 V."""

    def cleanup(self) -> None:
        """Give back what `configure` took."""

    @property
    def stage(self) -> str:
        """`unconfigured`, `inactive`, `active` or `finalized`."""
        return str(self._state_machine.current_state[1])

    def start_by_itself(self, until: str = ACTIVE) -> None:
        """As far as `until`, unless the parameter `managed` leaves that to a manager.

        Raises:
            InputError: why it cannot be.
        """
        if not self.settings["managed"]:
            for move in (self.trigger_configure, self.trigger_activate):
                if self.stage != until:
                    self.require(move)

    def require(self, move: Callable[[], TransitionCallbackReturn]) -> None:
        """Make a transition; InputError where it fails or does not begin in this state."""
        self._refusal = f"is {self.stage}"
        try:
            done = move() == TransitionCallbackReturn.SUCCESS
        except RuntimeError:  # rclpy's, of a transition that does not begin here
            done = False
        if not done:
            raise InputError(self._refusal)

    def on_configure(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Called by ROS."""
        return self._moved(self.configure)

    def on_activate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Called by ROS."""
        return self._moved(self.activate)

    def on_deactivate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Called by ROS."""
        return self._moved(self.deactivate)

    def on_cleanup(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Called by ROS."""
        return self._moved(self.cleanup)

    def on_shutdown(self, before: LifecycleState) -> TransitionCallbackReturn:
        """Called by ROS; from whatever state."""
        if before.label == ACTIVE:
            self._moved(self.deactivate)
        return self._moved(self.cleanup) if before.label != UNCONFIGURED else _done()

    def _moved(self, act: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            act()
        except InputError as error:
            self._refusal = str(error)
            self.get_logger().error(self._refusal)
            return TransitionCallbackReturn.FAILURE
        return _done()


def _done() -> TransitionCallbackReturn:
    return TransitionCallbackReturn.SUCCESS
