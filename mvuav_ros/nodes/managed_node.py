"""Managed (lifecycle) nodes that start by themselves."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from mvuav_ros.nodes.live_parameters import LiveParameters, unused_overrides


class ManagedNode(LifecycleNode):
    """A node with ROS 2's managed states, which configures and activates itself by default.

    Subclasses declare their parameters, ``autostart`` among them, as ``_live`` and say what the
    transitions do: `open` for configure, `begin` for activate, `end` for deactivate, `close` for
    cleanup and shutdown. `open` and `begin` may raise: the state stays what it was, and the reason
    is logged. `end` and `close` must not, and do nothing the second time.
    """

    siblings: Sequence[ManagedNode] = ()  # The nodes of the process, this one included
    overrides_problem = ''  # What was given at the start and has no effect, in words
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
        unused = unused_overrides(self, self.siblings), _unused_remappings(self, self.siblings)
        problem = '; '.join(filter(None, unused))
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


_INPUTS = 'image_raw', 'camera_info', 'imu'
"""Of all nodes, though a topic of one of them is there only in some modes."""


def _unused_remappings(node: ManagedNode, siblings: Sequence[ManagedNode]) -> str:
    """Say which rules, such as ``-r image:=/nose/image``, name no topic or service of the process.

    One that turns the two names round counts as such too. Those for a node of that name are left.
    """
    nodes = {node, *siblings}
    if any(each.lifecycle_state not in ('active', 'activating') for each in nodes):
        return ''  # it has its topics only then
    names = set[str]()
    for each in nodes:
        topics: Iterable[Any] = (*each.publishers, *each.subscriptions)
        names.update(topic.topic_name for topic in topics)
        names.update(service.service_name for service in each.services)
    expand = partial(node.resolve_topic_name, only_expand=True)
    inputs = {expand(name) for name in _INPUTS}
    said = []
    for option, rule in pairwise(sys.argv):
        old, _, new = rule.partition(':=')
        if option in ('-r', '--remap') and ':' not in old and not old.startswith('__'):
            is_used = expand(old) in inputs or expand(new) in names - inputs
            said += [] if is_used else [rule]
    return f'remappings without effect: {", ".join(said)}' if said else ''
