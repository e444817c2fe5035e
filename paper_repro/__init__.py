"""The paper's tables and figures, and what the paper leaves open: one module an artefact, one command for all.

`artefacts` are made of what `measure` finds; `make` runs the jobs and writes tables, figures and the report.
"""
