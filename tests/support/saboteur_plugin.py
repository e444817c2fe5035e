"""What a user hands to `compare --plugin`."""

from saboteurs import register_all

register_all()
