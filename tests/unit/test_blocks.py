import numpy as np
import pytest

from babble.blocks import BlockError, BlockSpec, BlockTree

HAND = [
    BlockSpec("thumb", 2, observes=(0, 1), drives=(0, 1)),
    BlockSpec("index", 3, observes=(2, 3, 4), drives=(2,)),
    BlockSpec("hand", 4, children=("thumb", "index")),
]


def test_one_block_has_the_whole_body():
    tree = BlockTree([BlockSpec("body", 2)], 3, 2)
    assert tree.levels == 1
    obs = np.arange(6.0).reshape(2, 3)
    np.testing.assert_array_equal(tree.observation_of("body", obs), obs)
    assert tree.driven("body").tolist() == [0, 1]
    assert (tree.observation_size_of("body"), tree.action_size_of("body")) == (3, 2)


def test_a_hand_of_two_fingers():
    tree = BlockTree(HAND[::-1], 5, 3)
    assert [[spec.name for spec in tree.level(k)] for k in range(tree.levels)] == [
        ["index", "thumb"],
        ["hand"],
    ]
    assert tree.level_of("hand") == 1
    obs = np.arange(5.0)[None]
    np.testing.assert_array_equal(tree.observation_of("index", obs), [[2, 3, 4]])
    latents = {"index": np.full((1, 3), 7.0), "thumb": np.full((1, 2), 5.0)}
    np.testing.assert_array_equal(tree.observation_of("hand", obs, latents), [[5, 5, 7, 7, 7]])
    assert tree.child_slices("hand") == {"thumb": slice(0, 2), "index": slice(2, 5)}
    assert tree.child_slices("thumb") == {}
    assert tree.action_size_of("hand") == tree.observation_size_of("hand") == 5
    assert tree.driven("hand").size == tree.observed("hand").size == 0


def test_a_block_stands_above_its_highest_child():
    arm = BlockSpec("arm", 2, observes=(0,), drives=(3,))
    body = BlockSpec("body", 2, children=("hand", "arm"))
    tree = BlockTree([body, arm, *HAND], 5, 4)
    assert [len(tree.level(k)) for k in range(tree.levels)] == [3, 1, 1]
    assert tree.level_of("body") == 2


def test_fingers_may_see_the_same_and_need_no_hand():
    tree = BlockTree([BlockSpec("a", 2, (0, 1), (0,)), BlockSpec("b", 2, (1,), (1,))], 2, 2)
    assert tree.levels == 1


def test_a_parent_needs_its_childrens_latents():
    with pytest.raises(BlockError, match="observes the latent of 'index', which was not given"):
        BlockTree(HAND, 5, 3).observation_of("hand", np.zeros((1, 5)), {"thumb": np.zeros((1, 2))})


@pytest.mark.parametrize(
    ("specs", "words"),
    [
        ([], "needs at least one block"),
        ([BlockSpec("a", 2), BlockSpec("a", 2)], "two blocks named 'a'"),
        ([BlockSpec("a", 1)], "latent_dim of at least 2"),
        ([BlockSpec("a", 2, observes=(5,))], "'a' observes 5, but the world has 0 to 4"),
        ([BlockSpec("a", 2, drives=(-1,))], "'a' drives -1, but the world has 0 to 2"),
        ([BlockSpec("a", 2, observes=(1, 1))], "observes 1 twice"),
        ([BlockSpec("a", 2, observes=())], "'a' observes nothing"),
        ([BlockSpec("a", 2, drives=(0, 1))], "no block drives 1 of the world's 3 actuators \\(2\\)"),
        ([BlockSpec("a", 2), BlockSpec("b", 2, drives=(1,))], "actuator 1 is driven by both 'a' and 'b'"),
        ([BlockSpec("a", 2, children=("b",))], "child 'b', which does not exist"),
        ([*HAND, BlockSpec("top", 2, children=("thumb",))], "'thumb' is a child of both 'hand' and 'top'"),
        ([BlockSpec("a", 2, children=("b",)), BlockSpec("b", 2, children=("a",))], "above itself"),
        ([BlockSpec("a", 2, children=("a",))], "above itself"),
        ([*HAND[:2], BlockSpec("hand", 2, (0,), children=("thumb",))], "cannot observe or drive"),
        ([*HAND[:2], BlockSpec("hand", 2, children=("thumb", "thumb"))], "child of both"),
    ],
)
def test_blocks_that_make_no_tree_are_refused(specs, words):
    with pytest.raises(BlockError, match=words):
        BlockTree(specs, 5, 3)


def test_an_unknown_block_is_named():
    with pytest.raises(BlockError, match="there is no block 'toe'; the blocks are thumb, index, hand"):
        BlockTree(HAND, 5, 3).observation_of("toe", np.zeros((1, 5)))
