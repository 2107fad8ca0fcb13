"""Reports: their contents as dictionaries (:mod:`.records`), and the files that show them (:mod:`.write`)."""
