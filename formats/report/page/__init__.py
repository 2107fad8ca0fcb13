"""Reports as one self-contained page: verdict, pictures, measures, run, times."""

from .document import as_html
from .figures import Figure

__all__ = ["Figure", "as_html"]
