"""The report of a comparison as one HTML file that people would rather look at than read."""

from comparisons.page.page import write_page

__all__ = ["write_page"]
