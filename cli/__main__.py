"""``python -m meshdeform_cli``."""

from .main import main

main()
