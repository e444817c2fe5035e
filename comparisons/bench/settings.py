"""How much a bench measures, in one frozen record."""

from dataclasses import dataclass

from prioritized_ik.errors import InputError
from prioritized_ik.models import DIRECTIONS
from prioritized_ik.validation import at_least
from prioritized_ik.weights import KINDS

ROBOT_LEVELS = (1, 2, 3, 6)
USUAL_LINKS = (8, 17, 34, 50, 100, 200, 400, 800, 1000)  # of arms, from which a range takes its own


@dataclass(frozen=True)
class BenchSettings:
    """Settings of one bench.

    Attributes:
        directions: keys of `models.DIRECTIONS`.
        weights: of the windings, some of `weights.KINDS`.
        stretches: of each winding, evenly spaced and each in succession, are timed.
        stretch: steps in one.
        changes: of contact that are timed of each winding besides, evenly spaced.
        repeats: of every stretch and track; a step's time is the median over them.
        tracks: random configurations that each robot starts from.
        track: steps from each of them.
        links: of the arms by which the growth is shown.
        lifted: links of the arms that sparse solvers are shown on.
        lifted_steps: of each of them.
        largest_rival: links up to which the growth is shown of other programs too.
        starts: fresh processes that the first call is timed in.
        profiled: steps under the profiler.
    """

    directions: tuple[str, ...] = tuple(DIRECTIONS)
    weights: tuple[str, ...] = KINDS
    stretches: int = 6
    stretch: int = 12
    changes: int = 6
    repeats: int = 3
    tracks: int = 8
    track: int = 6
    links: tuple[int, ...] = (8, 17, 34, 50, 100, 200, 400, 800)
    lifted: tuple[int, ...] = (17, 100, 400)
    lifted_steps: int = 10
    largest_rival: int = 100
    starts: int = 5
    profiled: int = 100

    def __post_init__(self) -> None:
        for name in ("stretches", "stretch", "changes", "repeats", "tracks", "track", "lifted_steps", "starts", "profiled"):
            at_least(name, getattr(self, name), 1)

    @staticmethod
    def quick() -> "BenchSettings":
        """Return settings that take less than a minute: for a look, not for figures to quote."""
        return BenchSettings(
            directions=("up", "back"),
            stretches=2,
            stretch=4,
            changes=2,
            repeats=1,
            tracks=2,
            track=3,
            links=(8, 17, 34),
            lifted=(17,),
            lifted_steps=2,
            largest_rival=17,
            starts=1,
            profiled=20,
        )

    @staticmethod
    def of_links(text: str) -> "BenchSettings":
        """Return settings of arms of the numbers of links that `text` names: a range such as 8..1000, or 17,100,400.

        Raises:
            InputError: neither, or numbers below 2.
        """
        first, dots, last = text.partition("..")
        try:
            named = [int(first), int(last)] if dots else [int(part) for part in text.split(",")]
        except ValueError:
            raise InputError(
                f"links is {text!r}; expected a range such as 8..1000, or numbers such as 17,100,400."
            ) from None
        for number in named:
            at_least("links", number, 2)
        if dots and named[0] > named[1]:
            raise InputError(f"links is {text!r}, which holds none; expected the smaller number first.")
        between = [number for number in USUAL_LINKS if dots and named[0] <= number <= named[1]]
        links = tuple(sorted({*named, *between}))
        return BenchSettings(links=links, lifted=tuple(n for n in BenchSettings.lifted if links[0] <= n <= links[-1]))
