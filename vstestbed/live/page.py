"""The page of a run: scene, picture, plots and panel, kept up to date from the thread that simulates."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from vstestbed.core.geometry import Array, pose_from, quaternion_wxyz
from vstestbed.live.eye import WIDTH, Eye
from vstestbed.live.plots import Plots
from vstestbed.live.run import PICTURE_S
from vstestbed.live.scene import SceneView
from vstestbed.live.transport import Sample
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.replay import Replay

SCENE_S, PLOTS_S = 1 / 30, 1 / 4
"""Least time on the wall between two updates of the scene, of plots [s]; of picture and words: `live.run`."""
VIEW_WIDTH, PANEL_WIDTH = 340, 330
"""Widths of the panels beside the scene [px]."""


class LiveView:
    """What pages show of a run besides its panel: scene, picture and plots.

    Args:
        server: of the pages. scenario: the experiment. first: the first sample.
        recorded: the samples have no pictures; they are drawn again.
    """

    def __init__(self, server: viser.ViserServer, scenario: Scenario, first: Sample, recorded: bool = False):
        self._server, self._recorded = server, recorded
        panel = server.gui.add_panel()
        self._tab = panel.add_tab("camera and curves")
        panel.dock_left()
        panel.set_width(VIEW_WIDTH)
        self._made_at: dict[str, float] = {}
        self._replay: Replay | None = None
        self._scenario = scenario
        self._build(first)

    def _build(self, first: Sample) -> None:
        if self._replay is not None:
            self._replay.close()
            self.eye.remove()
            self.plots.remove()
        scenario, self._unit = self._scenario, first.unit
        self._replay = _replay_of(scenario)
        self.scene = SceneView(self._server, scenario, self._replay, first)
        with self._tab:
            self.eye = Eye(self._server.gui, scenario, self._replay)
            self.plots = Plots(self._server.gui, scenario, first.unit)

    def restart(self, scenario: Scenario, first: Sample) -> bool:
        """Begin anew; whether the scene is another one, so that all that others put into it is gone."""
        parts = [(s.robot, s.camera, s.target, s.target_in_run.sheet, s.world) for s in (scenario, self._scenario)]
        other = parts[0] != parts[1] or first.unit != self._unit
        self._scenario = scenario
        if other:
            self._build(first)
        else:
            self.forget()
        return other

    def forget(self) -> None:
        """Begin curves and trails anew."""
        self.eye.clear()
        self.plots.clear()
        self.scene.clear()

    def add(self, sample: Sample) -> None:
        """A frame was made, whether it is drawn or not."""
        self.plots.add(sample)
        self.scene.extend_trail(sample.film.T_world_camera[:3, 3])

    def draw(self, sample: Sample, tell: Callable[[], None], now: bool = False) -> None:
        """Send what is due; `now`: everything. tell: writes what the page says of the sample, which goes with its picture alone."""
        if not self._server.get_clients() and not now:  # nobody looks
            return
        pictured = now or self._has_picture(sample)
        if pictured or self._due("scene", SCENE_S):
            with self._server.atomic():
                self.scene.show(sample, self.eye.draw(sample) if pictured else None)
                if pictured:
                    tell()
        if now or self._due("plots", PLOTS_S):
            self.plots.draw()
            self.scene.draw_trail()

    def _has_picture(self, sample: Sample) -> bool:
        """Whether a sample has a picture, or one is to be drawn for it."""
        return sample.film.image is not None or (self._recorded and self._due("picture", PICTURE_S))

    def _due(self, what: str, period_s: float) -> bool:
        """Whether something was not sent for a while; it is to be sent now."""
        t = time.monotonic()
        if t - self._made_at.get(what, -np.inf) < period_s:
            return False
        self._made_at[what] = t
        return True

    def close(self) -> None:
        """Free the scene."""
        if self._replay is not None:
            self._replay.close()


def _replay_of(scenario: Scenario) -> Replay:
    """The scene again, whose servo camera makes pictures as large as they are shown."""
    parts = scenario.robot, scenario.camera, scenario.target_in_run, scenario.world
    return Replay(*parts, shadows=False, sights=scenario.sights, share=min(1.0, WIDTH / scenario.camera.width))


class Gizmo:
    """A handle in the scene at which something is dragged.

    Args:
        server: of the pages. name: in the scene. T: pose (4, 4). size_m: its length. dragged: called with the pose, from another thread.
    """

    def __init__(self, server: viser.ViserServer, name: str, T: Array, size_m: float, dragged: Any):
        self._handle = server.scene.add_transform_controls(
            name, scale=size_m, position=T[:3, 3], wxyz=quaternion_wxyz(T[:3, :3]), depth_test=False
        )

        async def moved(event: Any) -> None:
            if event.client is not None:
                dragged(pose_from(np.array(event.target.position), np.array(event.target.wxyz)))

        self._handle.on_update(moved)

    def remove(self) -> None:
        """Take it away."""
        self._handle.remove()
