"""A robot and what it is asked to do, to look at: targets, contacts, and a panel that says which level gives way to what.

`picture` draws one state, `Film` writes a motion to a file (`.gif`, `.webp`, `.mp4`, or its last state as `.png`), both off
screen; `View` shows it live, in MuJoCo's own window where there is a display and in a web page on localhost otherwise.
"""

from prioritized_ik.viewer.canvas import Camera
from prioritized_ik.viewer.film import Film, picture
from prioritized_ik.viewer.live import View

__all__ = ["Camera", "Film", "View", "picture"]
