"""Reports as one self-contained page: verdict, pictures, measures, run, times."""

from .document import as_html

__all__ = ["as_html"]
