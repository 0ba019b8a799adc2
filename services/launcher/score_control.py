"""The control of a run: the scores of a policy trained on an encoder that has learned nothing."""

import numpy as np

from babble.limbs import BlockModels
from babble.noise import Noise, make_noise
from babble.worlds import World
from protocol.messages import Phase, Score
from services.launcher.evaluate import MODES, roll_out
from services.launcher.scored_run import Run, RunError, Version
from services.runtime.settings import RunSettings

LEARNER_PACKAGES = frozenset({"torch", "stable_baselines3", "onnx"})


def control_rows(opened: Run, *, seed: int, columns: int) -> list[Score]:
    """A row per mode, of a policy trained with the run's own budget. Raises `RunError`."""
    block = opened.settings.block[0].name
    control = Version(block=block, iteration=0, phase=Phase.GROUND, encoder=0, policy=0)
    models = {block: _train_control(opened, block, seed)}
    rolled = [roll_out(opened, [control], models, seed=seed, columns=columns, mode=mode) for mode in MODES]
    return [row for rollout in rolled for row in rollout.scores()]


def _train_control(opened: Run, block: str, seed: int) -> BlockModels:
    """A policy trained on an untrained encoder with the run's own settings and budget. Raises `RunError`."""
    try:
        from babble.control import train_on_untrained_encoder
    except ModuleNotFoundError as error:
        if error.name not in LEARNER_PACKAGES:
            raise
        raise RunError(
            f"the control trains a policy and needs {error.name}, which is not installed here; "
            "install it with `make setup`, or `.venv/bin/uv sync --locked --inexact --extra learner`"
        ) from None
    settings = opened.settings.of_block(block)
    phases = settings.phases
    world = opened.world(settings.policy.rollout_columns, [seed, 6, 2])
    _check_whole_body(opened, world)
    ppo = settings.policy.model_dump(exclude={"rollout_columns", "max_policy_lag", "subgoals"})
    try:
        # The body may break down, and a sense may find only now that it has no renderer.
        encoder, policy = train_on_untrained_encoder(
            world,
            settings.one_block(block).latent_dim,
            noise=_babbling(settings, world, seed),
            walk_steps=phases.babble_steps,
            train_steps=phases.ground_steps + phases.iterations * phases.practise_steps,
            goal_period_steps=settings.goals.period_steps,
            encoder_hidden=tuple(settings.encoder.hidden),
            vision_features=settings.encoder.vision_features,
            encoder_output=settings.encoder.output,
            seed=seed,
            steps=settings.actors.segment_steps,
            reward_form=settings.goals.reward,
            **settings.goals.model_dump(include={"sparse_radius", "goal_weight", "external_weight"}),
            **ppo,
        )
    except ValueError as error:
        raise RunError(f"the control of {opened.shown} cannot be trained here: {error}") from None
    return BlockModels(encoder, policy)


def _babbling(settings: RunSettings, world: World, seed: int) -> Noise:
    return make_noise(
        **settings.babbling.drawn,
        columns=world.columns,
        size=world.action_size,
        rng=np.random.default_rng([seed, 6, 3]),
    )


def _check_whole_body(opened: Run, world: World) -> None:
    tree = opened.tree
    (spec, *others) = tree.specs.values()
    senses = np.array_equal(tree.observed(spec.name), np.arange(world.observation_size))
    moves = np.array_equal(tree.driven(spec.name), np.arange(world.action_size))
    if others or not senses or not moves:
        raise RunError(
            f"{opened.shown}: the control is for runs of one block that senses and moves the whole body; "
            f"this one has {', '.join(tree.specs)}"
        )
