"""Optional extras of this package: what each brings, and how to get it."""

from importlib.util import find_spec

from prioritized_ik.errors import MissingExtraError

#: Extras, and what each brings that is imported.
EXTRAS = {
    "cluster": ("dask", "distributed"),
    "compare": ("mink", "polars"),
    "mink": ("mink",),
    "render": ("PIL", "imageio_ffmpeg"),
    "report": ("cvxpy", "markdown_it", "matplotlib", "mink", "PIL", "polars", "pylatexenc"),
    "solvers": ("cvxpy",),
    "view": ("mjviser", "viser"),
}


def require_extra(extra: str) -> None:
    """Return if what an extra of this package brings is installed.

    Raises:
        MissingExtraError: it is not; the message says how to get it.
    """
    missing = [name for name in EXTRAS[extra] if find_spec(name) is None]
    if missing:
        raise MissingExtraError(
            f"{', '.join(missing)} not installed; get the extra by: pip install 'prioritized-ik[{extra}]'."
        )
