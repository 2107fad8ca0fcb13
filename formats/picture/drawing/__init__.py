"""From polygons to files: depth buffer, image, lines, colours, pages of panels."""
