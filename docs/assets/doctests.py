"""Shows the doctests of docstrings as code on the documentation's pages; used by mkdocs.yml."""

import re

import griffe


class Examples(griffe.Extension):
    """Puts every paragraph that begins with `>>>` between fences."""

    def on_object(self, *, obj: griffe.Object, **_: object) -> None:
        """Rewrites the docstring of an object."""
        if obj.docstring is not None:
            obj.docstring.value = re.sub(
                r"^(>>> .*(?:\n.+)*)", r"```pycon\n\1\n```", obj.docstring.value, flags=re.M
            )
