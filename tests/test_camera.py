"""Rays and projection are inverse; paths move as far as they promise."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ataa_jax import camera, paths, vector
from ataa_jax.errors import InputError
from ataa_jax.scene import CameraSource

SIZE = (9, 16)


def test_the_middle_ray_looks_down_minus_z_and_depth_is_distance_along_it():
    eye = camera.make(np.eye(4), np.pi / 2)
    middle = jnp.asarray([8.0], jnp.float32), jnp.asarray([4.5], jnp.float32)
    direction = camera.directions(eye, SIZE, *middle)
    np.testing.assert_array_equal(vector.stack(direction), [[0.0, 0.0, -1.0]])
    # At 90° the top edge's middle lies 45° up.
    top = camera.directions(eye, SIZE, middle[0], middle[1] * 0.0)
    np.testing.assert_allclose(vector.stack(top), [[0.0, 1.0, -1.0]], atol=1e-6)


@given(
    st.floats(0.0, 16.0),
    st.floats(0.0, 9.0),
    st.floats(-3.0, 3.0),
    st.floats(1e-2, 1e4),
)
def test_projection_inverts_rays(x, y, yaw, distance):
    pose = camera.look_at(np.zeros(3), np.array([np.sin(yaw), 0.3, np.cos(yaw)]))
    eye = camera.make(pose, 1.0)
    at = jnp.asarray([x], jnp.float32), jnp.asarray([y], jnp.float32)
    point = camera.directions(eye, SIZE, *at) * distance
    x_px, y_px, in_front = camera.project(eye, SIZE, point)
    assert bool(in_front[0])
    # A rotation and a division in float32: a few ulp of 16 px.
    np.testing.assert_allclose([x_px[0], y_px[0]], [at[0][0], at[1][0]], atol=2e-5)


def test_points_behind_or_beside_the_camera_are_flagged_and_finite():
    eye = camera.make(np.eye(4), 1.0)
    points = vector.unstack(
        jnp.asarray([[0, 0, 1], [1, 0, 0], [1, 1, -1e-9], [0, 0, 0]], jnp.float32)
    )
    x_px, y_px, in_front = camera.project(eye, SIZE, points)
    assert not np.any(in_front)
    assert np.all(np.isfinite(x_px))
    assert np.all(np.isfinite(y_px))


def start(eye=(0.0, 0.0, 0.0), target=(0.0, 0.0, -1.0)) -> CameraSource:
    pose = camera.look_at(np.array(eye), np.array(target))
    return CameraSource("start", pose, np.radians(50.0))


def travel(kind: str, motion: float, at: np.ndarray) -> float:
    """How far, in image widths, a point moves from frame 0 to frame 1."""
    path = paths.CameraPath(kind=kind, motion=motion)
    seen = []
    for frame in (0, 1):
        pose = paths.pose(path, start(), 10.0, 16 / 9, frame)
        eye = camera.make(pose.world_from_view, pose.fov_y)
        offset = at - pose.world_from_view[:3, 3]
        point = vector.unstack(jnp.asarray([offset], jnp.float32))
        x_px, _, _ = camera.project(eye, (90, 160), point)
        seen.append(float(x_px[0]))
    return abs(seen[1] - seen[0]) / 160.0


@pytest.mark.parametrize("motion", [0.01, 0.1])
def test_a_pan_moves_the_middle_by_its_motion(motion):
    found = travel("pan", motion, np.array([0.0, 0.0, -10.0]))
    assert found == pytest.approx(motion, rel=1e-3)


def test_a_dolly_moves_the_edge_at_the_focus_by_its_motion():
    half_width = 10.0 * np.tan(np.radians(25.0)) * 16 / 9
    found = travel("dolly", 0.01, np.array([half_width, 0.0, -10.0]))
    assert found == pytest.approx(0.01, rel=0.05)  # 1/z grows over the step


def test_an_orbit_keeps_its_focus_in_the_middle():
    assert travel("orbit", 0.05, np.array([0.0, 0.0, -10.0])) < 1e-5


def test_still_paths_do_not_move_and_frame_zero_is_the_camera_itself():
    for kind in ("still", "pan", "orbit", "dolly", "walk"):
        pose = paths.pose(paths.CameraPath(kind=kind), start(), 10.0, 16 / 9, 0)
        np.testing.assert_allclose(pose.world_from_view, start().world_from_view)


def test_keyframes_pass_through_their_positions(tmp_path):
    file = tmp_path / "path.toml"
    file.write_text(
        'kind = "keyframes"\n'
        "[[keyframe]]\nframe = 0\nposition = [0, 0, 5]\ntarget = [0, 0, 0]\n"
        "[[keyframe]]\nframe = 10\nposition = [4, 0, 5]\ntarget = [0, 1, 0]\n"
        "fov_y_degrees = 30\n"
    )
    path = paths.load(str(file))
    first = paths.pose(path, start(), 1.0, 1.0, 0)
    last = paths.pose(path, start(), 1.0, 1.0, 10)
    np.testing.assert_allclose(first.world_from_view[:3, 3], [0, 0, 5])
    np.testing.assert_allclose(last.world_from_view[:3, 3], [4, 0, 5])
    assert last.fov_y == pytest.approx(np.radians(30))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("kind = 3", "kind"),
        ('kind = "keyframes"', "at least two"),
        ("motion = -1", "motion"),
        ("motion = nan", "motion"),
        ("speed = 2", "unknown key"),
        ("kind = ", "not valid TOML"),
        ("fps = true", "fps"),
        ("[[keyframe]]\nframe = 0", "kind 'walk' reads none"),
    ],
)
def test_a_bad_path_file_is_one_clear_sentence(tmp_path, text, message):
    file = tmp_path / "bad.toml"
    file.write_text(text)
    with pytest.raises(InputError, match=message) as error:
        paths.load(str(file))
    assert "\n" not in str(error.value).split("not valid TOML")[0]


def test_a_key_that_no_keyframe_has_is_refused_by_name(tmp_path):
    file = tmp_path / "path.toml"
    key = "position = [0, 0, 5]\ntarget = [0, 0, 0]\n"
    file.write_text(
        f'kind = "keyframes"\n[[keyframe]]\nframe = 0\n{key}'
        f"[[keyframe]]\nframe = 9\n{key}fov = 30\n"
    )
    message = "keyframe 1 has the unknown key 'fov'; known are fov_y_degrees, frame, "
    with pytest.raises(InputError, match=message):
        paths.load(str(file))


@pytest.mark.parametrize("motion", [-1.0, "-1", "nan", "1.5", "fast"])
def test_a_bad_motion_is_told_by_its_option_value_and_range(motion):
    with pytest.raises(InputError) as caught:
        paths.load("walk", motion)
    assert str(caught.value).startswith("--motion must be typical, rapid or a share")
    assert f"from 0 to 1, not {motion!r}" in str(caught.value)


def test_the_exact_name_of_a_camera_comes_before_kinds_of_paths():
    cameras = ["orbit", "deck:pan", "a:b"]

    def reading(text: str) -> tuple[str | None, str]:
        path = paths.load(text, cameras=cameras)
        return path.camera, path.kind

    assert reading("orbit") == ("orbit", "walk")
    assert reading("orbit:orbit") == ("orbit", "orbit")
    assert reading("deck:pan") == ("deck:pan", "walk")
    assert reading("deck:pan:still") == ("deck:pan", "still")
    assert reading("a:b") == ("a:b", "walk")
    assert reading("a:b:dolly") == ("a:b", "dolly")
    assert reading("pan") == (None, "pan")
    assert reading(":pan") == (None, "pan")


def test_names_of_paths_and_cameras_are_told_apart():
    assert paths.load("orbit").kind == "orbit"
    assert paths.load("boat").camera == "boat"
    both = paths.load("boat:pan", "rapid")
    assert (both.camera, both.kind, both.motion) == ("boat", "pan", 0.1)
    # No kind of path: a camera, which the scene then turns out to have or not.
    for text in ("boat:fly", "boat:keyframes", "keyframes"):
        assert (paths.load(text).camera, paths.load(text).kind) == (text, "walk")
