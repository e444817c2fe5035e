"""An arm of 200 links and 598 joints winds three turns around a thin post, each step certified link by link."""

import prioritized_ik as pik
from prioritized_ik.models import Arm
from prioritized_ik.winding.picture import record
from prioritized_ik.winding.settings import in_proportion

link_length = 1.02 / 200  # [m]
settings = pik.WindingSettings(
    arm=Arm(links=200, link_length=link_length, radius=0.004),
    link=60,  # touches first
    size=(0.03, 0.5),  # of the post: radius and half length [m]
    tilt=0.5,  # so that turns lie side by side
    weights="trailing",  # the links that come after the next one are free
    options=pik.SolveOptions(rank_tolerance=0.0),  # long arms are weak in directions that count
    **in_proportion(link_length) | {"speed": 0.085},
)
episode = pik.wind(settings)
print(episode.outcome.value)
print(f"{pik.measure(episode).turns:.2f} turns in {episode.steps} steps")
record(episode, "long_arm.webp")
