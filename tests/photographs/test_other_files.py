"""NeRF's transforms, OpenCV's calibrations and Bundler's reconstructions."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

import djpt
from djpt.photographs.opencv import of_matrices
from tests.kit.photographs import HEIGHT, PLACES, WIDTH, bundle, calibration, rotation, transforms, write
from tests.photographs.projected import require_as_in_opencv

K = [[60.0, 0, 31], [0, 58, 25], [0, 0, 1]]
"""Pixels count from the corner."""
IN_OPENCV = [[60.0, 0, 30.5], [0, 58, 24.5], [0, 0, 1]]
"""From the centre of the first pixel."""
DISTORTION = [-0.1, 0.03, 0.004, -0.003, 0.01]


# ---- transforms.json -------------------------------------------------------------------------


def test_transforms_of_instant_ngp(tmp_path):
    file = transforms(k1=-0.1, k2=0.03, p1=0.004, p2=-0.003, k3=0.01, aabb_scale=4)
    write(tmp_path, {"transforms.json": file})
    require_as_in_opencv(djpt.load_cameras(tmp_path), K, DISTORTION)


def test_transforms_of_a_fisheye(tmp_path):
    k = {"k1": 0.02, "k2": -0.01, "k3": 0.004, "k4": -0.001}
    for entry in ({"is_fisheye": True}, {"camera_model": "OPENCV_FISHEYE"}):
        write(tmp_path, {"transforms.json": transforms(**k, **entry)})
        require_as_in_opencv(djpt.load_cameras(tmp_path), K, list(k.values()), fisheye=True)


def test_transforms_of_blender(tmp_path):
    """One angle, no sizes: these are the pictures', whose suffix is missing."""
    file = {"camera_angle_x": 0.7, "frames": transforms()["frames"]}
    write(tmp_path, {"transforms_train.json": file})
    for n in range(2):
        djpt.write(tmp_path / f"view {n}.png", np.zeros((HEIGHT, WIDTH, 3), np.float32))
    photographs = djpt.load_cameras(tmp_path)
    focal = 0.5 * WIDTH / math.tan(0.35)
    require_as_in_opencv(photographs, [[focal, 0, WIDTH / 2], [0, focal, HEIGHT / 2], [0, 0, 1]], [0.0] * 4)
    sensor = photographs[0].sensor()
    np.testing.assert_allclose([sensor["fov"], sensor["principal_point_offset_x"]], [math.degrees(0.7), 0], atol=1e-12)
    assert photographs[1].path == tmp_path / "view 1.png"


def test_entries_of_a_frame_win(tmp_path):
    file = transforms()
    file["frames"][1] |= {"fl_x": 70.0, "w": 32, "h": 24}
    write(tmp_path, {"transforms.json": file})
    a, b = (view.lens for view in djpt.load_cameras(tmp_path))
    assert (a.fx, a.width, b.fx, b.width) == (60, 64, 70, 32)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frames": 3}, "'frames' must be a list"),
        ({"frames": [3]}, r"frames\[0\] must be an object"),
        ({"frames": [{}]}, r"frames\[0\]: 'transform_matrix' must have 4 x 4 or 3 x 4 numbers"),
        ({"fl_x": "wide"}, r"frames\[0\]: 'fl_x' must be a finite number, found 'wide'"),
        ({"fl_x": 10**400}, r"'fl_x' must be a finite number"),
        ({"fl_x": float("nan")}, r"'fl_x' must be a finite number"),
        ({"w": True}, r"frames\[0\]: 'w' must be a finite number, found True"),
        ({"k4": 0.1}, r"a camera of the model OPENCV has no 'k4'"),
        ({"is_fisheye": True, "p1": 0.1}, r"a camera of the model OPENCV_FISHEYE has no 'p1'"),
        ({"camera_model": "FOV"}, r"no sensor has the 'camera_model' 'FOV'; possible: .*OPENCV"),
        ({"camera_model": ["x"]}, r"no sensor has the 'camera_model'"),
        ({"latlong": True}, r"'latlong' is of a lens that no sensor has"),
    ],
)
def test_damage_of_transforms_is_named(tmp_path, change, message):
    write(tmp_path, {"transforms.json": transforms(**change)})
    with pytest.raises(djpt.SceneError, match=f"^transforms.json: .*{message}"):
        djpt.load_cameras(tmp_path)


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.diag([1, 1, 3, 1]), "isn't a rotation"),
        (np.diag([1, 1, -1, 1]), "isn't a rotation"),
        (np.zeros((4, 4)), "isn't a rotation"),
        (np.full((4, 4), 1e31), "must be finite numbers"),
        (np.eye(3), "must have 4 x 4 or 3 x 4 numbers, found 3 x 3"),
    ],
)
def test_a_camera_has_a_place(tmp_path, matrix, message):
    file = transforms()
    file["frames"][0]["transform_matrix"] = matrix.tolist()
    write(tmp_path, {"transforms.json": file})
    with pytest.raises(djpt.SceneError, match=rf"frames\[0\]: 'transform_matrix' {message}"):
        djpt.load_cameras(tmp_path)


def test_what_is_missing_is_said(tmp_path):
    file = transforms()
    for key, message in (("fl_x fl_y", "neither 'fl_x' nor 'camera_angle_x'"), ("w", "its size isn't known")):
        write(tmp_path, {"t.json": {k: v for k, v in file.items() if k not in key.split()}})
        with pytest.raises(djpt.SceneError, match=rf"t\.json: frames\[0\].*{message}"):
            djpt.load_cameras(tmp_path / "t.json")
    write(tmp_path, {"t.json": transforms(rolling_shutter=[0, 0, 0.1, 0])})
    with pytest.warns(UserWarning, match=r"t\.json: 'rolling_shutter' is left out"):
        djpt.load_cameras(tmp_path / "t.json")


# ---- OpenCV ----------------------------------------------------------------------------------


def test_a_calibration_in_yaml(tmp_path):
    pytest.importorskip("yaml")
    write(tmp_path, {"camera.yml": calibration()})
    require_as_in_opencv(djpt.load_cameras(tmp_path / "camera.yml"), K, DISTORTION)


def test_a_calibration_that_opencv_has_written(tmp_path):
    cv2 = pytest.importorskip("cv2")
    pytest.importorskip("yaml")
    for name in ("camera.yml", "camera.json"):
        storage = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_WRITE)
        for key, value in (("image_width", WIDTH), ("image_height", HEIGHT)):
            storage.write(key, value)
        rows = np.array([[*turn, *move] for turn, move in PLACES])
        for key, array in (("camera_matrix", IN_OPENCV), ("dist_coeffs", DISTORTION), ("extrinsic_parameters", rows)):
            storage.write(key, np.array(array))
        storage.release()
        require_as_in_opencv(djpt.load_cameras(tmp_path / name), K, DISTORTION)


def test_a_calibration_of_ros(tmp_path):
    pytest.importorskip("yaml")
    rows = {"rows": 3, "cols": 3, "data": np.ravel(IN_OPENCV).tolist()}
    fields = {"camera_name": "left", "image_width": WIDTH, "image_height": HEIGHT, "camera_matrix": rows}
    fields |= {"distortion_model": "equidistant", "D": [0.02, -0.01, 0.004, -0.001]}
    fields |= {"rvecs": [turn for turn, _ in PLACES], "tvecs": [move for _, move in PLACES]}
    write(tmp_path, {"ros.yaml": json.dumps(fields)})  # JSON is YAML
    require_as_in_opencv(djpt.load_cameras(tmp_path / "ros.yaml"), K, fields["D"], fisheye=True)


def test_matrices_as_arrays(tmp_path):
    turns = [np.array(turn)[:, None] for turn, _ in PLACES]
    moves = [np.array(move)[:, None] for _, move in PLACES]  # the shapes that calibrateCamera returns
    require_as_in_opencv(of_matrices(IN_OPENCV, [DISTORTION], turns, moves, size=(WIDTH, HEIGHT)), K, DISTORTION)
    matrices = [rotation(turn) for turn, _ in PLACES]
    require_as_in_opencv(of_matrices(IN_OPENCV, DISTORTION, matrices, moves, size=(WIDTH, HEIGHT)), K, DISTORTION)
    one = of_matrices(IN_OPENCV, size=(WIDTH, HEIGHT), images=[tmp_path / "a.png"])
    assert len(one) == 1 and np.allclose(one[0].to_world, np.diag([-1, -1, 1, 1]))
    assert one[0].path == tmp_path / "a.png"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([[60, 1, 30], [0, 60, 20], [0, 0, 1]],), "the camera matrix must be"),
        ((np.eye(2),), "the camera matrix must have 3 x 3 numbers, found 2 x 2"),
        ((K, [0] * 8 + [0.1]), "no sensor has the coefficient 's1'"),
        ((K, [0] * 15), "there are at most 14 coefficients, found 15"),
        ((K, None, np.zeros(4)), "must be matrices 3 x 3 or vectors of 3 numbers"),
        ((K, None, np.zeros((2, 3)), np.zeros((3, 3))), "there are 2 rotations and 9 numbers"),
        ((K, None, 2 * np.eye(3)[::-1]), "view 0 isn't a rotation"),
        ((K, ["a"]), "the distortion must be numbers"),
    ],
)
def test_wrong_matrices_are_refused(arguments, message):
    with pytest.raises(djpt.SceneError, match=f"^of_matrices: .*{message}"):
        of_matrices(*arguments, size=(WIDTH, HEIGHT))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("camera_matrix", "cam", "has no camera matrix; possible: .*; found: image_width, image_height, cam"),
        ("rows: 3", "rows: 4", "4 x 3 need other data than 9 numbers"),
        ("60., 0.", "60., x", "the camera matrix must be numbers"),
        ("image_width: 64", "image_width: many", "the width must be a finite number, found 'many'"),
        ("image_width: 64", "image_width: [", "isn't YAML"),
        ("image_width: 64", "a: &a [*a, *a]\nimage_width: 64", "refers to itself"),
        ("cols: 6", "cols: 3", "the extrinsic parameters"),
        (calibration(), "- 1", "must hold keys and values, found"),
        (calibration(), "", "must hold keys and values"),
    ],
)
def test_damage_of_calibrations_is_named(tmp_path, old, new, message):
    pytest.importorskip("yaml")
    assert old in calibration()
    write(tmp_path, {"camera.yml": calibration().replace(old, new)})
    with pytest.raises(djpt.SceneError, match=rf"^camera\.yml: .*{message}"):
        djpt.load_cameras(tmp_path / "camera.yml")


def test_texts_that_grow_when_they_are_read_are_refused(tmp_path):
    pytest.importorskip("yaml")
    layers = "\n".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 10))
    write(tmp_path, {"camera.yml": f"a0: &a0 [1, 2]\n{layers}\nK: *a9\n", "large.yml": b"a: " + b"1" * 2**20})
    with pytest.raises(djpt.SceneError, match=r"camera\.yml: refers to itself"):
        djpt.load_cameras(tmp_path / "camera.yml")
    with pytest.raises(djpt.SceneError, match=r"large\.yml: has 1048579 bytes; calibrations have at most"):
        djpt.load_cameras(tmp_path / "large.yml")
    write(tmp_path, {"deep.json": b'{"frames": ' + b"[" * 10**6})
    with pytest.raises(djpt.SceneError, match=r"deep\.json: isn't JSON"):
        djpt.load_cameras(tmp_path / "deep.json")


# ---- Bundler ---------------------------------------------------------------------------------


def test_bundler(tmp_path):
    names = "unplaced.jpg\n./a/view 0.jpg 0 60.0\n./a/view1.jpg\n"
    write(tmp_path, {"bundle.out": bundle(), "list.txt": names})
    write(tmp_path / "images", {"view1.jpg": b""})
    photographs = djpt.load_cameras(tmp_path, tmp_path / "images", size=(WIDTH, HEIGHT), points=True)
    matrix = [[60, 0, WIDTH / 2], [0, 60, HEIGHT / 2], [0, 0, 1]]
    require_as_in_opencv(photographs, matrix, [-0.1, 0.03, 0, 0])
    assert [view.path for view in photographs] == [None, tmp_path / "images" / "view1.jpg"]
    assert photographs.points.tolist() == [[0.1, -0.2, 0.3], [1.0, 0.5, -0.4]]
    np.testing.assert_allclose(photographs.colors[0], [1, 0.21586, 0], atol=1e-5)
    with pytest.raises(djpt.SceneError, match=r"bundle\.out: camera 1: its size isn't known"):
        djpt.load_cameras(tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"# Bundle", b"# Pundle", "isn't a file of Bundler"),
        (b"3 2\n", b"30 2\n", "ends within its 30 cameras"),
        (b"3 2\n", b"3 200\n", "ends within its 200 points"),
        (b"3 2\n", b"3", "a count must be a finite number|ends within"),
        (b"60.0", b"-60.0", "camera 1: focal lengths must be greater than 0"),
        (b"2 0 4", b"9 0 4", "point 0 must be a whole number from 0 to 3"),
        (b"255", b"256", "point 0 must be a whole number from 0 to 255"),
    ],
)
def test_damage_of_bundles_is_named(tmp_path, old, new, message):
    assert old in bundle()
    write(tmp_path, {"bundle.out": bundle().replace(old, new)})
    with pytest.raises(djpt.SceneError, match=rf"^bundle\.out: .*({message})"):
        djpt.load_cameras(tmp_path / "bundle.out", size=(WIDTH, HEIGHT), points=True)
