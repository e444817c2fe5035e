"""All artefacts, in the order of the report. A new one is one module and one line here."""

import importlib

from paper_repro.make.artefact import Artefact
from prioritized_ik.validation import one_of

#: Chapters of the report and the modules of their artefacts.
CHAPTERS: dict[str, tuple[str, ...]] = {
    "What the paper says": (
        "facts",
        "table_1_equations",
    ),
    "The arm and its solve": (
        "figure_1_virtual_arms",
        "figure_2_spaces",
        "figure_3_cases",
        "figure_4_contact",
        "table_3_cases",
        "figure_5_arm",
        "table_2_ranks",
        "figure_rank_tolerance",
    ),
    "The solve as a QP": (
        "solvers",
        "figure_agreement",
        "table_4_backends",
        "table_5_damping",
        "figure_damping",
        "drop_in",
        "table_6_weight_ratio",
        "figure_weight_ratio",
        "table_7_timing",
    ),
    "Winding": (
        "closed_form_map",
        "figure_closed_form_map",
        "closed_form_stability",
        "outcomes",
        "figure_6_windings",
        "figure_7_weights",
        "figure_penetration",
        "table_8_windings",
        "table_9_ablation",
        "table_10_failures",
        "table_11_distributed",
        "table_12_rivals",
        "table_13_torques",
        "table_14_holding",
        "figure_holding",
    ),
    "What the paper leaves open": (
        "leaves_open",
        "choices",
        "sensitivity",
    ),
    "Every winding of the map": ("closed_form_episodes",),
}


def artefacts() -> list[Artefact]:
    """Return all artefacts."""
    return [artefact for chapter in by_chapter().values() for artefact in chapter]


def by_chapter() -> dict[str, list[Artefact]]:
    """Return the artefacts of each chapter. Their modules are imported now."""
    return {
        chapter: [importlib.import_module(f"paper_repro.artefacts.{module}").ARTEFACT for module in modules]
        for chapter, modules in CHAPTERS.items()
    }


def chosen(names: tuple[str, ...]) -> list[Artefact]:
    """Return the artefacts called `names`, in the order of the report; all if there are none.

    Raises:
        InputError: there is no such artefact.
    """
    known = {artefact.name: artefact for artefact in artefacts()}
    for name in names:
        one_of("artefact", name, known)
    return [artefact for name, artefact in known.items() if not names or name in names]
