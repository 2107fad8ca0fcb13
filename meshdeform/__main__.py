"""``python -m meshdeform``: the command line."""

from meshdeform_cli.main import main

if __name__ == "__main__":
    main()
