"""One robot in several mazes, side by side."""

from eihrl_jax import base
from eihrl_jax.config import gallery as gallery_config
from eihrl_jax.drawing import animation, film, montage
from eihrl_jax.physics import kinematics, scene
from eihrl_jax.reporting import facade


def draw(options: gallery_config.GalleryConfig) -> tuple[facade.Episode, ...]:
    """Runs an episode in each maze and animates them together; returns the episodes.

    Raises:
      base.UserError: a maze, robot or high level is unknown or damaged, or the file exists.
    """
    film.check(options.out)
    if options.out.exists():
        raise base.UserError(f"{options.out} exists already; name another --out")

    hierarchy = facade.load(options.high, robot=options.robot)
    mazes = hierarchy.into(*options.mazes)
    episodes = tuple(mazes.run(options.seed, maze) for maze in range(len(options.mazes)))

    options.out.parent.mkdir(parents=True, exist_ok=True)
    films = [_frames(episode, options.width) for episode in episodes]
    film.save(options.out, montage.side_by_side(films, options.num_frames))
    return episodes


def _frames(episode: facade.Episode, width: int) -> list[montage.Frame]:
    """Returns an episode's frames without the panel beside the maze."""
    robot = episode.robot
    frames = animation.render(
        episode.recording,
        kinematics.capsules(scene.build(robot), robot.units_per_metre),
        title="",
        reach=robot.reach * robot.units_per_metre,
        camera="whole",
    )
    return [montage.resized(frame[:, : animation.MAZE_SIZE[0]], width) for frame in frames]
