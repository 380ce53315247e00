"""A joint whose force levels tell it, beside linear modes that are not known either."""
