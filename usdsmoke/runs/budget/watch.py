"""Findings of a window's frames, told while the window is computed."""

from collections.abc import Iterator, Mapping
from typing import Any

from usdsmoke.base.frame_report import FrameReport
from usdsmoke.planning.plan import VolumePlan
from usdsmoke.runs.budget.finding import Finding
from usdsmoke.runs.budget.findings import find_written, frames_before
from usdsmoke.runs.budget.light_findings import find_scene
from usdsmoke.runs.budget.planned import PlannedVolume


class WindowFindings:
    """The findings of a window, as far as it is computed."""

    def __init__(
        self, volume: VolumePlan, scene: Mapping[str, Any], reports: Mapping[str, FrameReport]
    ) -> None:
        """
        Args:
            scene: the Volume's, as measured.
            reports: of the frames that are finished already, by file name.
        """
        self._volume = PlannedVolume(volume, (), scene)
        self._before = frames_before(volume)
        self._reports = dict(reports)

    def of_scene(self) -> Iterator[Finding]:
        """The findings of the Volume's scene."""
        return find_scene(self._volume)

    def of_frame(self, name: str, report: FrameReport) -> Iterator[Finding]:
        """The findings of a frame that is finished now, also beside the frame before it.

        Args:
            name: of the frame's file.
        """
        self._reports[name] = report
        plan, before = self._volume.plan, self._before.get(name)
        return find_written(name, self._reports, before, plan.config, len(plan.frames) == 1)
