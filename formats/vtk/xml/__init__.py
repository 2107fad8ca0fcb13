"""VTK's XML files: tags, arrays and their encodings, structured grids read and written."""
