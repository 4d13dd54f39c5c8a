"""``python -m setrl`` is the same program as ``setrl``."""

from .cli import main

if __name__ == "__main__":
    main()
