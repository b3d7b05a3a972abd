"""Mitsuba's denoiser, by its name and its call."""

from __future__ import annotations

from typing import Any

import numpy as np

from djpt.errors import ArgumentError, BackendError, near_miss
from djpt.images.bitmap import Bitmap
from djpt.jit.types import TensorXf
from djpt.rendering.denoising.filtering import check_method, denoise, numbers

__all__ = ["OptixDenoiser"]


class OptixDenoiser:
    """Removes the noise of images of one size, by Intel's Open Image Denoise: djpt needs no OptiX.

    Args:
        input_size: Width and height of the images.
        albedo: Whether calls bring an albedo.
        normals: Whether calls bring normals; they need an albedo.
        temporal: Must be False: Open Image Denoise looks at one image at a time.
        denoise_alpha: Whether alpha is filtered, too.

    Raises:
        ArgumentError: normals without an albedo.
        BackendError: `temporal`, or Open Image Denoise isn't installed.
    """

    def __init__(
        self,
        input_size: Any,
        albedo: bool = False,
        normals: bool = False,
        temporal: bool = False,
        denoise_alpha: bool = False,
    ) -> None:
        if temporal:
            raise BackendError("Open Image Denoise looks at one image at a time: 'temporal' must be False")
        if normals and not albedo:
            raise ArgumentError("'normals' need an albedo: albedo=True")
        check_method("oidn")
        width, height = (int(number) for number in input_size)
        self._size = width, height
        self._albedo, self._normals, self._alpha = albedo, normals, denoise_alpha

    def __call__(
        self,
        noisy: Any,
        albedo: Any = None,
        normals: Any = None,
        to_sensor: Any = None,
        flow: Any = None,
        previous_denoised: Any = None,
        noisy_ch: str = "<root>",
        *,
        albedo_ch: str = "",
        normals_ch: str = "",
    ) -> Any:
        """The image without its noise, of the kind of `noisy`.

        Args:
            noisy: A tensor (H, W, 3 or 4), or a `Bitmap`.
            albedo: A tensor (H, W, 3); for a bitmap, the name of its layer.
            normals: As `albedo`.
            to_sensor: A transform of the normals; without effect, because the filter takes them in any frame.
            flow: Of no use without `temporal`, and so is `previous_denoised`.
            previous_denoised: See `flow`.
            noisy_ch: The layer of a bitmap with the image.
            albedo_ch: Another name for the argument `albedo` of bitmaps.
            normals_ch: Another name for the argument `normals` of bitmaps.

        Raises:
            ArgumentError: another size, a missing albedo or missing normals, or a layer that the bitmap lacks.
        """
        if not isinstance(noisy, Bitmap):
            return self._cleaned(noisy, albedo, normals)
        layers = dict(noisy.split())

        def layer(name: str) -> TensorXf:
            if name not in layers:
                raise ArgumentError(f"the bitmap has no layer '{name}'{near_miss(name, layers)}")
            return TensorXf(np.array(layers[name], np.float32))

        found = [layer(name) if name else None for name in (albedo or albedo_ch, normals or normals_ch)]
        return Bitmap(self._cleaned(layer(noisy_ch), *found))

    def _cleaned(self, noisy: Any, albedo: Any, normals: Any) -> TensorXf:
        pixels = numbers("noisy", noisy)
        height, width, count = pixels.shape
        if (width, height) != self._size:
            raise ArgumentError(f"'noisy' must have {self._size[0]} x {self._size[1]} pixels, found {width} x {height}")
        for name, wanted, given in (("albedo", self._albedo, albedo), ("normals", self._normals, normals)):
            if wanted and given is None:
                raise ArgumentError(f"'{name}' is missing: the denoiser was made with {name}=True")
        result = denoise(pixels, albedo if self._albedo else None, normals if self._normals else None)
        if self._alpha and count in (2, 4):
            cleaned = np.array(result)
            cleaned[..., -1:] = np.clip(np.array(denoise(pixels[..., -1:])), 0, 1)
            result = TensorXf(cleaned)
        return result
