"""Files of tests for processes side by side, such that a run ends whatever dies."""

from __future__ import annotations

from typing import Any

from xdist.scheduler import LoadFileScheduling

__all__ = ["FileScheduling"]


class FileScheduling(LoadFileScheduling):
    """As ``--dist loadfile``, but a test that its process doesn't survive fails once.

    xdist gives the file to the next process from that test on, so each dies of it. And a process begins a test when it
    knows what comes next: one that is given a single test, while others are queued that nobody else is there to take,
    waits for ever.
    """

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.fatal: set[str] = set()

    def remove_node(self, node: Any) -> str | None:
        pending = [test for file in self.assigned_work[node].values() for test, done in file.items() if not done]
        self.fatal.update(pending[:1])
        return super().remove_node(node)

    def _assign_work_unit(self, node: Any) -> None:
        tests = next(iter(self.workqueue.values()))
        tests.update(dict.fromkeys(self.fatal & tests.keys(), True))
        super()._assign_work_unit(node)

    def _reschedule(self, node: Any) -> None:
        if node not in self.registered_collections:
            return
        super()._reschedule(node)
        while self.workqueue and not node.shutting_down and self._pending_of(self.assigned_work[node]) < 2:
            self._assign_work_unit(node)
