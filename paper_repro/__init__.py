"""The paper's tables and figures, and what the paper leaves open: one module an artefact, one command for all."""
