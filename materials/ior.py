"""Indices of refraction, by name or number: of dielectrics, and of metals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from djpt.description.properties import Allowed, Properties
from djpt.errors import SceneError, near_miss
from djpt.jit.types import Color3f
from djpt.textures.base import Texture

__all__ = ["ETA", "IOR", "METALS", "ior", "metal"]

IOR: Final = {
    "acetone": 1.36,
    "acrylic glass": 1.49,
    "air": 1.000277,
    "amber": 1.55,
    "benzene": 1.501,
    "bk7": 1.5046,
    "bromine": 1.661,
    "carbon dioxide": 1.00045,
    "carbon tetrachloride": 1.461,
    "diamond": 2.419,
    "ethanol": 1.361,
    "fused quartz": 1.458,
    "glycerol": 1.4729,
    "helium": 1.000036,
    "hydrogen": 1.000132,
    "pet": 1.575,
    "polypropylene": 1.49,
    "pyrex": 1.47,
    "silicone oil": 1.52045,
    "sodium chloride": 1.544,
    "vacuum": 1.0,
    "water": 1.333,
    "water ice": 1.31,
}
"""Indices for yellow light (589 nm) at 0 to 20 degrees Celsius, as in Mitsuba; most are from E. Hecht, "Optics"."""


def ior(props: Properties, key: str, default: str | float) -> float:
    """The index under `key`: one of the names in `IOR` (in any case), or a number > 0."""
    value = props.raw(key, default)
    if not isinstance(value, str):
        return props.float(key, low=0.0, low_open=True) if key in props else float(value)
    name = value.lower()
    if name not in IOR:
        raise props.error(key, f"must be a number or the name of a medium, found '{value}'{near_miss(name, IOR)}")
    return IOR[name]


ETA: Final[Mapping[str, Allowed]] = {"eta": Allowed(0.0, low_open=True)}
"""The range of a parameter `eta`, a relative index."""

Rgb = tuple[float, float, float]

METALS: Final[dict[str, tuple[Rgb, Rgb]]] = {
    "none": ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
    "a-C": ((2.944046, 2.227136, 1.968162), (0.8874649, 0.7992985, 0.81529)),
    "Ag": ((0.1552762, 0.116728, 0.1383876), (4.828354, 3.122222, 2.146901)),
    "Al": ((1.657501, 0.8804047, 0.5212445), (9.223811, 6.269502, 4.837004)),
    "AlAs": ((3.605296, 3.232938, 2.216319), (0.0006794373, 0.0, 0.007512709)),
    "AlSb": ((0.0, 4.139375, 4.669254), (0.0, 0.09400908, 1.30057)),
    "Au": ((0.143036, 0.3753071, 1.442045), (3.982997, 2.385556, 1.603359)),
    "Be": ((4.185012, 3.185029, 2.784061), (3.835466, 3.010122, 2.868994)),
    "Cr": ((4.369668, 2.916505, 1.654905), (5.206547, 4.231306, 3.754699)),
    "CsI": ((2.1449, 1.702319, 1.662427), (0.0, 0.0, 0.0)),
    "Cu": ((0.2010055, 0.9237495, 1.102215), (3.913262, 2.453045, 2.14209)),
    "Cu2O": ((3.551773, 2.94987, 2.751875), (0.114207, 0.1938969, 0.6061339)),
    "Cu_palik": ((0.2132285, 0.9197154, 1.102411), (3.921873, 2.457332, 2.136584)),
    "CuO": ((3.247541, 2.447805, 2.21022), (0.5210896, 0.5700307, 0.7221789)),
    "d-C": ((2.70872, 2.318826, 2.228898), (0.0, 0.0, 0.0)),
    "Hg": ((2.398939, 1.440028, 0.9095704), (6.327587, 4.371925, 3.421764)),
    "HgTe": ((4.77904, 3.231196, 2.659901), (1.631613, 1.58081, 1.729287)),
    "Ir": ((3.0863, 2.082191, 1.617915), (5.592153, 4.067088, 3.267312)),
    "K": ((0.06404319, 0.04640977, 0.03818491), (2.1042, 1.34894, 0.9131259)),
    "Li": ((0.2657909, 0.1956183, 0.2209486), (3.540155, 2.311123, 1.668607)),
    "MgO": ((2.089584, 1.650723, 1.594879), (4.332695e-12, 0.0, 2.498646e-11)),
    "Mo": ((4.483974, 3.525131, 2.77631), (4.111437, 3.420827, 3.150607)),
    "Na_palik": ((0.06026936, 0.05614095, 0.06198843), (3.179273, 2.11249, 1.579041)),
    "Nb": ((3.420074, 2.790093, 2.395629), (3.441395, 2.737666, 2.579746)),
    "Ni_palik": ((2.367305, 1.663373, 1.467078), (4.498812, 3.050153, 2.345439)),
    "Rh": ((2.585793, 1.860216, 1.554263), (6.78226, 4.702987, 3.976073)),
    "Se": ((4.058311, 2.842935, 2.820853), (0.7540495, 0.6384435, 0.5218076)),
    "Se-e": ((5.722849, 4.165736, 4.081338), (0.8711363, 1.105157, 1.56532)),
    "SiC": ((3.172342, 2.525972, 2.479371), (7.537664e-07, 0.0, 1.019253e-05)),
    "SnTe": ((4.52425, 1.981645, 1.281591), (0.0, 0.0, 0.0)),
    "Ta": ((2.062721, 2.392939, 2.627929), (2.40836, 1.741486, 1.947028)),
    "Te": ((7.390234, 4.482105, 2.637106), (3.256022, 3.527059, 3.292054)),
    "Te-e": ((7.508907, 4.296429, 2.369988), (5.583929, 4.947205, 3.997592)),
    "ThF4": ((1.830714, 1.442229, 1.387648), (0.0, 0.0, 0.0)),
    "TiC": ((3.700528, 2.837422, 2.582287), (3.265635, 2.351589, 2.172791)),
    "TiN": ((1.64845, 1.150516, 1.379823), (3.368328, 1.943498, 1.102068)),
    "TiO2": ((3.45661, 2.801736, 2.905175), (0.0001052648, 0.0, 0.0006528865)),
    "TiO2-e": ((3.106565, 2.513168, 2.582444), (2.975161e-05, 0.0, 0.0001826981)),
    "V_palik": ((4.277582, 3.512949, 2.761071), (3.491301, 2.889455, 3.111522)),
    "VC": ((3.657566, 2.752736, 2.532672), (3.068301, 2.198687, 1.963193)),
    "VN": ((2.865602, 2.119189, 1.940091), (3.032243, 2.056116, 1.616306)),
    "W": ((4.370817, 3.300246, 2.998407), (3.500641, 2.604874, 2.273233)),
}
"""(eta, k) for linear sRGB; `none` reflects everything.

As Mitsuba 3.9.1 (variant `llvm_ad_rgb`) computes them from the measured spectra in its `data/ior`, which come from the
luxpop.com database; the names with `_palik` from the "Handbook of Optical Constants of Solids", edited by E. D. Palik,
1985. Components that would be negative, for colours beyond sRGB, are 0.
"""

SAME_IN_PALIK: Final = (
    "AlAs AlSb Be CsI Cu2O CuO d-C Hg HgTe Ir K Li MgO Mo Nb Rh Se-e Se SiC SnTe Ta Te-e Te ThF4 TiC TiN TiO2-e "
    "TiO2 VC VN"
)
METALS.update({f"{name}_palik": METALS[name] for name in SAME_IN_PALIK.split()})

LARGEST: Final = 1e6
"""The largest eta and k, far beyond any solid's; Fresnel's equations overflow for larger ones."""


def metal(props: Properties) -> tuple[Texture, Texture]:
    """The textures eta and k, given by these keys or by the name of a `material`.

    Defaults: eta 0, k 1, material `none`. Only one of the two ways may be used; all values lie in [0, 1e6].
    """
    name = props.string("material", "none")
    if name not in METALS:
        raise props.error("material", f"can't be '{name}'{near_miss(name, METALS)}")
    given = [key for key in ("eta", "k") if key in props]
    if name != "none":
        if given:
            raise SceneError(
                f"{props.node}: give either 'material' or 'eta' and 'k', found 'material' and '{given[0]}'"
            )
        eta, k = METALS[name]
        named = {"eta": Color3f(*eta), "k": Color3f(*k)}
        props = Properties(props.plugin_name(), props.node, named, props.id())
    return props.texture("eta", 0.0, low=0.0, high=LARGEST), props.texture("k", 1.0, low=0.0, high=LARGEST)
