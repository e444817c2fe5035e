"""The tables and figures, one module each, with its caption."""
