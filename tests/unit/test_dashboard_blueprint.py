"""The page: which views there are for which run."""

from collections.abc import Iterator

import pytest
import rerun as rr
import rerun.blueprint as rrb

from services.dashboard.blueprint import TABS, blueprint_of
from services.dashboard.body import BodyPanel
from services.runtime.settings import RunSettings
from tests.unit.dashboard_feed import settings_of


@pytest.fixture(autouse=True)
def _strict() -> None:
    rr.set_strict_mode(True)


def page_of(settings: RunSettings) -> rrb.Tabs:
    page = blueprint_of(settings, BodyPanel(settings)).root_container
    assert isinstance(page, rrb.Tabs)
    return page


def views(part: rrb.Container | rrb.View) -> Iterator[rrb.View]:
    if isinstance(part, rrb.View):
        yield part
    else:
        for child in part.contents:
            yield from views(child)


@pytest.mark.parametrize("latent_dim", [2, 3, 4, 6])
def test_there_are_five_tabs_and_each_has_views(latent_dim: int) -> None:
    page = page_of(settings_of(latent_dim))
    assert tuple(tab.name for tab in page.contents) == TABS
    assert all(list(views(tab)) for tab in page.contents)
    kinds = {type(view) for view in views(page.contents[1])}
    assert (rrb.Spatial3DView in kinds) is (latent_dim == 4)
    assert (rrb.Spatial2DView in kinds) is (latent_dim != 4)


def test_with_several_blocks_each_has_a_tab_and_the_overview_says_where() -> None:
    page = page_of(settings_of(2, 3, 4))
    for number in (1, 3):
        inner = page.contents[number]
        assert isinstance(inner, rrb.Tabs)
        assert [tab.name for tab in inner.contents] == ["block-0", "block-1", "block-2"]
    first = next(views(page.contents[0]))
    assert first.name == "Latents of block-0, one of 3 blocks (all: tab Latent)"


def test_eyes_are_left_out_where_there_are_none() -> None:
    names = [str(view.origin) for view in views(page_of(settings_of(2)))]
    assert not [name for name in names if name.startswith("/eyes")]
