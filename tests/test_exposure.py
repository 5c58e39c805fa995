"""How bright a scene is: the same in any program's tiles, and from the cache."""

import numpy as np
import pytest

from ataa_jax import exposure
from ataa_jax import world as worlds
from tests import tiny
from tests.test_world import bare


@pytest.fixture
def folder(monkeypatch, tmp_path):
    monkeypatch.setenv("ATAA_CACHE", str(tmp_path))
    return tmp_path / "exposure"


def scene():
    return bare([tiny.floor(20.0), tiny.cube(2.0)])


@pytest.mark.parametrize("size", [(45, 80), (40, 47), (91, 161)])
def test_the_size_that_will_be_rendered_does_not_matter(folder, size):
    alone, given = worlds.prepare(scene()), worlds.prepare(scene(), size=size)
    assert len(list(folder.iterdir())) == 2  # both were drawn
    assert given.exposure == pytest.approx(alone.exposure, rel=1e-5)
    np.testing.assert_allclose(
        given.scene.sky.bounce, alone.scene.sky.bounce, rtol=1e-4
    )


def test_the_tiles_together_are_the_view(folder):
    """Colour by colour: a wrong place or scale of one tile would show."""
    world = worlds.prepare(scene())
    camera = world.cameras[0]
    groups = world.source.transforms(0.0)
    eye = worlds.cameras.make(camera.world_from_view, camera.fov_y)

    def draw(size):
        config = exposure.raster.Config(size=size, shading=world.shading)
        return exposure._draw(world.scene, world.tracer, groups, eye, config)[0]

    whole = draw(exposure.PREVIEW)
    tiles = draw((45, 80))
    assert whole.shape == tiles.shape
    order = [np.sort(colors.sum(axis=1)) for colors in (whole, tiles)]
    close = np.isclose(*order, rtol=1e-3)
    assert close.mean() > 0.999


def test_it_is_measured_once(folder, monkeypatch):
    first = worlds.prepare(scene())
    monkeypatch.setattr(exposure, "_draw", lambda *_: pytest.fail("drawn again"))
    again = worlds.prepare(scene())
    assert again.exposure == first.exposure
    np.testing.assert_array_equal(again.scene.sky.bounce, first.scene.sky.bounce)
    np.testing.assert_array_equal(again.rays.shadow, first.rays.shadow)


def test_another_scene_and_a_damaged_file_are_measured_anew(folder):
    first = worlds.prepare(scene())
    (file,) = folder.iterdir()
    file.write_bytes(file.read_bytes()[:50])
    assert worlds.prepare(scene()).exposure == first.exposure
    other = worlds.prepare(bare([tiny.floor(20.0), tiny.cube(4.0)]))
    assert len(list(folder.iterdir())) == 2
    assert other.exposure != first.exposure
