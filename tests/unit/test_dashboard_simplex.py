"""Where latents lie on the page."""

import numpy as np
import pytest

from services.dashboard.simplex import simplex_of

DIMS = [2, 3, 4, 5, 6, 9, 64]


@pytest.mark.parametrize("latent_dim", DIMS)
def test_vertices_are_places_of_one_hot_latents_and_the_mean_is_in_the_middle(latent_dim: int) -> None:
    simplex = simplex_of(latent_dim)
    one_hot = np.eye(latent_dim, dtype=np.float32)
    assert np.allclose(simplex.place(one_hot), simplex.vertices)
    assert np.allclose(np.linalg.norm(simplex.vertices, axis=1), 1.0, atol=1e-6)
    assert np.allclose(simplex.place(one_hot.mean(axis=0, keepdims=True)), 0.0, atol=1e-6)
    assert np.allclose(simplex.middle(), 0.0, atol=1e-6)


@pytest.mark.parametrize("latent_dim", [2, 3, 4])
def test_up_to_four_vertices_the_drawing_is_one_to_one(latent_dim: int) -> None:
    simplex = simplex_of(latent_dim)
    assert not simplex.flattened
    between = [np.linalg.norm(simplex.vertices[a] - simplex.vertices[b]) for a, b in simplex.edges]
    assert len(between) == latent_dim * (latent_dim - 1) // 2
    assert np.allclose(between, between[0], atol=1e-6), "all vertices are as far apart"
    assert np.linalg.matrix_rank(simplex.vertices[1:] - simplex.vertices[0]) == latent_dim - 1


def test_a_polygon_says_what_it_does_not_show() -> None:
    simplex = simplex_of(6)
    assert simplex.flattened
    assert "flattened" in simplex.reading
    halves = np.zeros((2, 6), np.float32)
    halves[0, [0, 3]] = halves[1, [1, 4]] = 0.5
    assert np.allclose(simplex.place(halves), 0.0, atol=1e-6), "so the caveat is true"
    assert "flattened" not in simplex_of(3).reading


@pytest.mark.parametrize("latent_dim", [3, 5, 6, 64])
def test_the_first_vertex_is_on_top_and_names_stand_outside_within_the_bounds(latent_dim: int) -> None:
    simplex = simplex_of(latent_dim)
    assert np.allclose(simplex.vertices[0], [0, -1], atol=1e-6), "y points down on the page"
    (left, right), (top, bottom) = simplex.bounds()
    assert (np.linalg.norm(simplex.labels(), axis=1) > 1.1).all()
    assert ((simplex.labels() > [left, top]) & (simplex.labels() < [right, bottom])).all()


def test_only_the_tetrahedron_is_solid() -> None:
    assert [latent_dim for latent_dim in DIMS if simplex_of(latent_dim).solid] == [4]
    assert simplex_of(4).vertices.shape == (4, 3)
