"""The contract of textures, and their uses by the plugins that hold them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, ClassVar

from djpt.core.records.flags import SurfaceDetail
from djpt.core.records.record import Wavelengths
from djpt.description.plugin import Plugin
from djpt.description.properties import Allowed, Properties
from djpt.description.registry import lookup
from djpt.errors import RenderError
from djpt.jit.types import Bool, Color3f, Float, Point2f, ScalarArray2i, UInt32, Vector2f

__all__ = ["Texture", "check_textures", "detail_read"]


SPECTRA = "no wavelengths: use eval or eval_3 for colours"


class Texture(Plugin):
    """A colour (linear sRGB) or a scalar that may vary over a surface.

    The eval methods run in kernels, once per class, with per-lane values (see
    `djpt.dispatch.ensemble`). `si` is anything with a `uv`: a surface interaction or a sample on a
    surface.
    """

    kind: ClassVar[str] = "texture"
    is_constant: ClassVar[bool] = False
    """True if the texture is the same everywhere: kernels then don't compute uv."""

    def eval(self, si: Any, active: Bool | bool = True) -> Color3f:
        """The colour at `si`."""
        raise NotImplementedError

    def eval_3(self, si: Any, active: Bool | bool = True) -> Color3f:
        """The colour at `si`: `eval`, since colours have three channels."""
        return self.eval(si, active)

    def eval_1(self, si: Any, active: Bool | bool = True) -> Float:
        """The scalar at `si`; of a colour what Mitsuba takes: the luminance of texels, the mean of an rgb."""
        raise NotImplementedError

    def eval_1_grad(self, si: Any, active: Bool | bool = True) -> Vector2f:
        """The change of `eval_1` per unit of u and of v; 0 for textures that don't vary."""
        if self.is_constant:
            return Vector2f(0)
        raise NotImplementedError

    def is_spatially_varying(self) -> bool:
        """True if the texture can differ from point to point."""
        return not self.is_constant

    def has_patches(self) -> bool:
        """True if colours jump along curves that stick to the surface, and divide it into patches."""
        return False

    def patch(self, si: Any) -> UInt32:
        """A number for the patch that `si` lies in; patches on both sides of a jump have different ones."""
        return UInt32(0)

    def resolution(self) -> ScalarArray2i:
        """The number of texels along u and v; 1 x 1 for textures without any."""
        return ScalarArray2i(1, 1)

    def max(self) -> float:
        """The largest value of all points and channels."""
        raise self.unknown("no largest value")

    def unknown(self, what: str) -> RenderError:
        """The error of a question that the texture has no answer to."""
        return RenderError(f"{self.id()}: a '{type(self).__name__}' has {what}")

    def pdf_spectrum(self, si: Any, active: Bool | bool = True) -> Any:
        """Raise `RenderError`: colours are red, green and blue, not spectra."""
        raise self.unknown(SPECTRA)

    wavelength_range = spectral_resolution = pdf_spectrum

    def sample_spectrum(self, si: Any, sample: Any = None, active: Bool | bool = True) -> tuple[Any, Color3f]:
        """Sample wavelengths: none, with the colour at `si`, as Mitsuba; raises `RenderError` unless `is_constant`."""
        if not self.is_constant:
            raise self.unknown(SPECTRA)
        return Wavelengths(), self.eval(si, active)

    @staticmethod
    def D65(scale: float = 1.0) -> Texture:
        """The white of a lamp: in red, green and blue the same number, `scale`."""
        texture: Texture = lookup("texture", "uniform")(Properties("uniform", "D65", {"value": scale}))
        return texture

    def prepare_sampling(self) -> None:
        """Build what `sample_position` needs; a light with this radiance asks for it, on the host."""

    def sample_position(self, sample: Point2f, active: Bool | bool = True) -> tuple[Point2f, Float]:
        """A point (u, v) of the unit square where the texture is bright, and its density; by default uniform."""
        return sample, Float(1)

    def pdf_position(self, p: Point2f, active: Bool | bool = True) -> Float:
        """The density of `sample_position` per unit of uv, for points of the unit square; detached."""
        return Float(1)

    def mean(self) -> Float:
        """The average over the texture's domain and channels."""
        raise NotImplementedError

    def used_by(self, kind: str) -> None:
        """Learn the kind of the plugin that uses the texture, before `restrict`: light and paint differ in colour."""

    def require_on(self, shape: Any) -> None:
        """Raise `SceneError` if the texture can't be used on a shape (`djpt.shapes.Shape`)."""

    def restrict(self, allowed: Allowed, where: str) -> None:
        """Require that all values are `allowed`, now and after each edit.

        Called by the plugin that uses the texture; `where` starts the message. A texture with
        several users must satisfy all of them.

        Raises:
            SceneError: a value lies outside.
        """
        raise NotImplementedError

    def restrict_colors(self, allowed: Allowed, where: str) -> None:
        """`restrict` for colours that light is multiplied by: images may exceed the upper bound, with a warning."""
        self.restrict(allowed, where)


def check_textures(shapes: Sequence[Any]) -> None:
    """Raise `SceneError` if a texture of a BSDF can't be used on its shape."""
    for shape in shapes:
        bsdf = shape.bsdf()
        if bsdf is not None:
            for texture in textures_in(bsdf):
                texture.require_on(shape)


def textures_in(plugin: Plugin) -> Iterator[Texture]:
    """All textures in a plugin, itself included."""
    if isinstance(plugin, Texture):
        yield plugin
    for name in plugin.children:
        child = getattr(plugin, name)
        if isinstance(child, Plugin):
            yield from textures_in(child)


def detail_read(plugin: Plugin) -> SurfaceDetail:
    """The parts of a surface point that `plugin`, or anything in it, asks for.

    What is sure to look at uv alone declares its parts; a script's class that doesn't may read all that there is.
    """
    if getattr(plugin, "needs_uv", False):
        return SurfaceDetail.PARTIALS
    if plugin.kind == "texture":
        read = SurfaceDetail.UV if isinstance(plugin, Texture) and not plugin.is_constant else SurfaceDetail.FRAME
    else:
        children = [getattr(plugin, name) for name in plugin.children]
        nested = (detail_read(c) for c in children if isinstance(c, Plugin) and c.kind != "shape")
        read = max(nested, default=SurfaceDetail.FRAME)
    return SurfaceDetail.PARTIALS if read and plugin.infers else read
