"""Managed (lifecycle) nodes that start by themselves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from mvuav_ros.nodes.live_parameters import LiveParameters, parameter_files, unused_overrides


class ManagedNode(LifecycleNode):
    """A node with ROS 2's managed states, which configures and activates itself by default.

    Subclasses declare their parameters, ``autostart`` among them, as ``_live`` and say what the
    transitions do: `open` for configure, `begin` for activate, `end` for deactivate, `close` for
    cleanup and shutdown. `open` and `begin` may raise: the state stays what it was, and the reason
    is logged. `end` and `close` must not, and do nothing the second time.
    """

    siblings: Sequence[ManagedNode] = ()  # The nodes of the process, this one included
    overrides_problem = ''  # Parameters given at the start that have no effect, in words
    failed = False  # Whether it broke in a way that ends the process with an error
    _live: LiveParameters[Any]

    def __init__(self, name: str) -> None:
        """Make the node, unconfigured."""
        super().__init__(name, start_parameter_services=False)
        self._mistake: Exception | None = None
        self._starting = False
        service = self._service_change_state
        service.callback = self._guarded(service.callback)

    def open(self) -> None:
        """Make what the node works with; nothing flows yet."""
        raise NotImplementedError

    def begin(self) -> None:
        """Let images flow."""
        raise NotImplementedError

    def end(self) -> None:
        """Stop the flow and let go of devices."""
        raise NotImplementedError

    def close(self) -> None:
        """Let go of what `open` made."""
        raise NotImplementedError

    @property
    def lifecycle_state(self) -> str:
        """``unconfigured``, ``inactive``, ``active``, ``finalized`` or a transition."""
        return str(self._state_machine.current_state[1])

    def report_parameters(self) -> None:
        """Log what was given at the start and has no effect."""
        unused = unused_overrides(self, self.siblings) + parameter_files(self)[1]
        problem = f'parameters without effect: {", ".join(unused)}' if unused else ''
        if problem not in ('', self.overrides_problem):
            self.get_logger().warning(problem)
        self.overrides_problem = problem

    def autostart(self) -> None:
        """Configure and activate if the parameter says so; raises what `open` and `begin` do."""
        if not self.get_parameter('autostart').value:
            self.get_logger().info('unconfigured; waiting for ~/change_state (autostart is false)')
            return
        self._starting = True
        try:
            for trigger in (self.trigger_configure, self.trigger_activate):
                if trigger() != TransitionCallbackReturn.SUCCESS and self._mistake is not None:
                    raise self._mistake
        finally:
            self._starting = False

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """See `open`."""
        done = self._attempt('configure', self.open, undo=self.close)
        self._live.freeze(done == TransitionCallbackReturn.SUCCESS)
        return done

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """See `begin`."""
        done = self._attempt('activate', self.begin, undo=self.end)
        if not self._starting:
            self.report_parameters()
        return done

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """See `end`."""
        self.end()
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """See `close`."""
        self.close()
        self._live.freeze(False)
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """See `end` and `close`."""
        self.end()
        return self.on_cleanup(state)

    # After a defect of ours: back to unconfigured, from where it can be tried again.
    on_error = on_shutdown

    def destroy_node(self) -> None:
        """End and close, then the node."""
        self.end()
        self.close()
        super().destroy_node()

    def _attempt(
        self, what: str, action: Callable[[], None], undo: Callable[[], None]
    ) -> TransitionCallbackReturn:
        self._mistake = None
        try:
            action()
        except Exception as error:
            self._mistake = error
            undo()
            if not self._starting:
                self.get_logger().error(f'cannot {what}: {error}')
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def _guarded(self, change: Callable[..., ChangeState.Response]) -> Callable[..., Any]:
        """Rclpy raises out of ``spin`` where a state has no such transition; the caller waits."""

        def answer(request: Any, response: ChangeState.Response) -> ChangeState.Response:
            try:
                return change(request, response)
            except rclpy_implementation.RCLError:
                wanted = request.transition.label or request.transition.id
                words = f'no transition {wanted} from state {self.lifecycle_state}'
                self.get_logger().warning(words)
                response.success = False
                return response

        return answer
