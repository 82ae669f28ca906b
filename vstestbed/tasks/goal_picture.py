"""The picture of a goal: a file from a real camera, or one that the simulated camera takes there, also under other light."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Gt, Le

from vstestbed.camera import Camera, Image
from vstestbed.core.errors import ParameterError
from vstestbed.core.named_files import absolute_file, place_of_file
from vstestbed.core.quantity import Narrower, Sigma
from vstestbed.core.spec import spec
from vstestbed.targets.picture_file import read_rgb

MID_GREY = 128.0
"""The grey level that a change of contrast leaves as it is."""
Factor = Annotated[float, Gt(0), Le(10)]


@spec
class GoalPicture:
    """The picture that was taken at the goal, for a law or a detector that compares with it.

    Without a file the simulated camera takes it there before the run, without noise. Under other light than the run's its grey levels I
    become contrast (brightness I - 128) + 128.

    Args:
        file: a PNG or JPEG file of the camera's size, from a real camera at the goal; its name alone is enough; e.g. `goal.png`.
        brightness: factor on the grey levels [1].
        contrast: factor on their distance from mid-grey [1].
        image_sigma: standard deviation of Gaussian noise on each channel [grey levels].
    """

    file: str | None = None
    brightness: Factor = 1.0
    contrast: Factor = 1.0
    image_sigma: Annotated[Sigma, Narrower(le=255)] = 0.0

    def __post_init__(self) -> None:
        """Make the name independent of the folder; refuse other light for a picture that is taken already."""
        if self.file is None:
            return
        object.__setattr__(self, "file", absolute_file(self.file, Path.cwd()))  # frozen; a run remembers where its picture is
        if self.other_light:
            words = "is for a picture that the simulated camera takes; leave it out, or the file"
            raise ParameterError("brightness" if self.brightness != 1 else "contrast" if self.contrast != 1 else "image_sigma", words)

    @property
    def other_light(self) -> bool:
        """Whether the picture that is taken is changed."""
        return (self.brightness, self.contrast, self.image_sigma) != (1.0, 1.0, 0.0)

    @property
    def draws(self) -> bool:
        """Whether a seed makes a difference to the picture: it has noise."""
        return self.image_sigma > 0

    @property
    def source(self) -> Path | None:
        """The file; None where the simulated camera takes the picture.

        Raises:
            ParameterError: it is not there.
        """
        return None if self.file is None else place_of_file(self.file)

    def read(self, camera: Camera) -> Image:
        """The file's picture (H, W, 3) RGB.

        Raises:
            ParameterError: it cannot be read, or is of another size than the camera's pictures.
        """
        assert self.source is not None
        image = read_rgb(self.source)
        height, width = image.shape[:2]
        if (width, height) != (camera.width, camera.height):
            words = f"has {width} x {height} px, and the camera's pictures have {camera.width} x {camera.height}"
            raise ParameterError("file", f"{words}; take it with this camera, or set camera.width and camera.height", self.file)
        return image

    def under_its_light(self, image: Image, rng: np.random.Generator) -> Image:
        """A picture (H, W, 3) that was taken in the light of the run, as it is under the light of teaching."""
        if not self.other_light:
            return image
        made = self.contrast * (self.brightness * image.astype(np.float32) - MID_GREY) + MID_GREY
        made += rng.standard_normal(image.shape, dtype=np.float32) * np.float32(self.image_sigma)
        return np.clip(made + 0.5, 0, 255).astype(np.uint8)
