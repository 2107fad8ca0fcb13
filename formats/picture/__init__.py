"""Pictures of grids: an image from a depth buffer in matplotlib axes, as png, svg or pdf.

:mod:`.subject` is a grid to draw, :mod:`.scene` what is drawn of it, :mod:`.raster` its image, :mod:`.page` puts images
into axes and files. :mod:`.overview` chooses what is shown, by default or by options.
"""
