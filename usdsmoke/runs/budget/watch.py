"""Findings of a window's frames, told while the window is computed."""

from collections.abc import Iterator, Mapping
from typing import Any

from usdsmoke.base.frame_report import FrameReport
from usdsmoke.planning.plan import VolumePlan
from usdsmoke.runs.budget.finding import Finding
from usdsmoke.runs.budget.findings import find_written, frames_before, names_measured
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
        self._before, self._measured = frames_before(volume), names_measured(volume)
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
        before, config = self._before.get(name), self._volume.plan.config
        return find_written(name, self._reports, before, config, name in self._measured)
