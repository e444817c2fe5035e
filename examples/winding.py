"""The paper's winding: 17 links and 49 joints wind around a tilted cylinder by touch alone."""

import prioritized_ik as pik
from prioritized_ik.winding.picture import record

settings = pik.WindingSettings(direction="up", tilt=0.3)
episode = pik.wind(settings)
print(episode.outcome.value)
print(f"{pik.measure(episode).turns:.2f} turns in {episode.steps} steps")
record(episode, "winding.webp")
