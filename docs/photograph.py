"""Photograph a page as a browser shows it: ``python docs/photograph.py PAGE OUT.png WIDTH HEIGHT light|dark``.

Needs the package PyQt6-WebEngine, which nothing else here needs. A process for every picture: the colour scheme belongs
to the browser.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

SETTLED = 4000
"""Milliseconds until fonts, pictures and layout of a page are in place."""


def photograph(page: Path, target: Path, width: int, height: int, scheme: str) -> None:
    """The top of a page, ``height`` pixels of it, in a window ``width`` pixels wide."""
    os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
    dark = " --blink-settings=preferredColorScheme=0" if scheme == "dark" else ""
    os.environ["QTWEBENGINE_CHROMIUM_FLAGS"] = f"--no-sandbox --disable-gpu --hide-scrollbars{dark}"
    from PyQt6.QtCore import QTimer, QUrl
    from PyQt6.QtWebEngineWidgets import QWebEngineView
    from PyQt6.QtWidgets import QApplication

    application = QApplication(sys.argv[:1])
    view = QWebEngineView()
    view.resize(width, height)
    view.show()

    def keep() -> None:
        view.grab().save(str(target))
        application.quit()

    view.loadFinished.connect(lambda _: QTimer.singleShot(SETTLED, keep))
    view.load(QUrl.fromLocalFile(str(page.resolve())))
    application.exec()


if __name__ == "__main__":
    source, picture, wide, high, colours = sys.argv[1:]
    photograph(Path(source), Path(picture), int(wide), int(high), colours)
