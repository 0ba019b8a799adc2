"""What people see of an actor: latents and postures of its columns, pose and sight of the first of them.

A picture is never a brake: none is drawn before it is due, what cannot be drawn or sent is counted, and
nothing of the worlds or their random numbers is touched, so that the experience is the same, seen or not.

A body acts faster than people can see, and poses many steps apart would jump. So poses play as a clip:
as many steps as are shown in a second are kept, one after the other, and sent at the pace of poses; then
the next clip begins. Where a step takes longer than the time between two poses, that is each newest one.
"""

from collections import deque
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager

from babble.legs import Seen, Witness
from babble.policy.act import Floats
from babble.worlds.batch import World
from babble.worlds.showing import Pose, Shown, shown
from protocol import keys
from protocol.codec import encode
from protocol.messages import ALL_BLOCKS, Arrays, View
from services.actor.sights import Pace, Trail
from services.runtime.process import Context

SELDOM = 4
"""Where this many trails fit between two pictures, only the steps of a trail are kept."""


class Views(Witness):
    """Publishes the views of one life; see `turn`."""

    def __init__(self, context: Context, world: World) -> None:
        self.sent = 0
        self.unshown = 0
        """Views that could not be drawn or sent."""
        self.last_error = ""
        self._context = context
        self._settings = settings = context.settings.view
        visible = context.index < settings.shown_actors
        self._latents = Pace(settings.latents_per_sec)
        self._poses = Pace(settings.poses_per_sec if visible else 0)
        self._images = Pace(settings.images_per_sec if visible else 0)
        self._trail = Trail(settings.trail_steps)
        self._clip: deque[tuple[int, Pose]] = deque()
        self._to_keep = 0
        """steps that the clip still wants"""
        self._shown: dict[int, Shown | None] = {}
        self._now_secs = 0.0
        self._env_steps = 0
        self._passed = 0
        """environment steps of each column since the last turn, where a level's step is several"""
        self.enter(0, world)

    def enter(self, term: int, world: World, limbs: Collection[str] = ()) -> None:
        """A new term, in which this world is acted in; `limbs` are the blocks that are not at work in it."""
        self._term, self._world, self._limbs = term, world, frozenset(limbs)
        self._clip.clear()
        self._to_keep = 0
        self.cut()
        self._always = self._settings.latents_per_sec > 0
        """keep every step for the trail, since there are few, or it is not yet known how many"""
        self._kept = 0
        """steps kept since the last picture, where not every step is"""
        self._pictured_step = self._env_step
        self.looking = False
        self.quiet_secs = 0.0
        """Nothing is due before this time, so there is no need to `turn`."""

    def turn(self, now_secs: float, env_steps: int) -> None:
        """Send what was kept and is due, and say whether the next step is to be seen.

        To be called after each step from `quiet_secs` on, and while there are none; `env_steps` are those
        of this life, summed over the columns.
        """
        self._env_steps, self._passed = env_steps, 0
        self._look(now_secs)

    def passed(self) -> None:
        """See `Witness.passed`: what falls due within a level's step does not wait for its end."""
        self._passed += 1
        now_secs = self._context.clock.now_secs()
        if now_secs >= self.quiet_secs:
            self._look(now_secs)

    def _look(self, now_secs: float) -> None:
        self._now_secs = now_secs
        if self._poses.due(now_secs):
            self._play()
        next_secs = min(self._latents.due_secs, self._images.due_secs)
        self.looking = self._always or self._to_keep > 0 or now_secs >= next_secs
        self.quiet_secs = 0.0 if self.looking else min(next_secs, self._poses.due_secs)

    def see(self, observation: Floats, seen: Mapping[str, Seen | None]) -> None:
        """See `Witness.see`."""
        if self._to_keep:
            self._keep_pose()
        if self._images.due(self._now_secs):
            self._publish_images(observation)
        if self._always or self._latents.due(self._now_secs):
            self._follow(seen)

    def cut(self) -> None:
        """See `Witness.cut`: the next trail begins anew."""
        self._trail.cut()

    @property
    def _env_step(self) -> int:
        return self._env_steps // self._world.columns + self._passed

    def _follow(self, seen: Mapping[str, Seen | None]) -> None:
        posture = self._world.posture()
        self._trail.add(posture, seen)
        self._kept += 1
        whole = self._always or self._kept >= self._settings.trail_steps
        if not whole or not self._latents.due(self._now_secs):
            return
        with self._shows("latent", self._latents):
            self._publish_latents(posture, seen)
        steps = self._env_step - self._pictured_step
        self._pictured_step = self._env_step
        self._always = steps < SELDOM * self._settings.trail_steps
        if not self._always:
            self._trail.cut()
            self._kept = 0

    def _publish_latents(self, posture: Floats, seen: Mapping[str, Seen | None]) -> None:
        columns = self._settings.columns
        body = {"posture": posture[:columns], "path": self._trail.path()}
        acted_on = {block: each for block, each in seen.items() if each is not None}
        for block, (latent, goal) in acted_on.items():
            # Where the body is, the blocks at work say; their limbs say only what they do.
            place = {} if block in self._limbs else body
            trail = self._trail.latents(block)
            self._publish(
                "latent", block, {"latent": latent[:columns], "goal": goal[:columns], "trail": trail, **place}
            )
        if self._limbs.issuperset(acted_on):
            self._publish("posture", ALL_BLOCKS, body)

    def _publish_images(self, observation: Floats) -> None:
        with self._shows("image", self._images):
            world = self._shown_world()
            images = {} if world is None else world.images(observation)
            for eye, pixels in images.items():
                self._publish("image", ALL_BLOCKS, {"pixels": pixels}, title=eye)

    def _play(self) -> None:
        if self._clip:
            with self._shows("pose", self._poses):
                env_step, pose = self._clip.popleft()
                arrays = {"position": pose.position, "quaternion": pose.quaternion}
                if pose.touch is not None:
                    arrays["touch"] = pose.touch
                self._publish("pose", ALL_BLOCKS, arrays, env_step=env_step)
        elif not self._to_keep:
            self._to_keep = max(1, round(self._settings.poses_per_sec))

    def _keep_pose(self) -> None:
        self._to_keep -= 1
        world, pose = self._shown_world(), None
        with self._shows("pose"):
            pose = None if world is None else world.pose()
        if pose is not None:
            self._clip.append((self._env_step, pose))
            if self._poses.due(self._now_secs):
                self._play()
        elif not self._clip:
            # Nothing to be seen: ask again when the next pose is due.
            self._to_keep = 0
            self._poses.done(self._now_secs)

    def _shown_world(self) -> Shown | None:
        """None for one that could not be shown when it was first tried."""
        key = id(self._world)
        if key not in self._shown:
            self._shown[key] = None
            with self._shows("body"):
                self._shown[key] = shown(self._world)
        return self._shown[key]

    @contextmanager
    def _shows(self, what: str, pace: Pace | None = None) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # noqa: BLE001 - no picture is worth the run
            self.unshown += 1
            self.last_error = f"a view ({what}) could not be shown: {error}"
        finally:
            if pace is not None:
                pace.done(self._now_secs)

    def _publish(
        self, view: str, block: str, arrays: Arrays, *, env_step: int | None = None, title: str = ""
    ) -> None:
        message = View.model_validate(
            {
                "run": self._context.run,
                "term": self._term,
                "block": block,
                "life": self._context.life,
                "seq": self.sent,
                "view": view,
                "env_step": self._env_step if env_step is None else env_step,
                "title": title,
                "arrays": arrays,
            }
        )
        self._context.bus.publish("view", keys.of(message), encode(message))
        self.sent += 1
