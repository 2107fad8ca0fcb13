"""The foldover-free energy of a deformed grid, its gradient, and its second derivatives or their convex part.

At sample points of every cell (corners; in weak hexahedra also the middles of edges, faces and cell) A is the Jacobian
matrix of the map from the undeformed cell to the deformed one, D = det A, and

    f = |A|^2 / (3 chi^(2/3)) + (D^2 + 1) / (2 chi),    chi = (D + sqrt(eps^2 + D^2)) / 2

(Garanzha, Kaporin, Kudryavtseva, Protais, Ray, Sokolov: Foldover-free maps in 50 lines of code, ACM TOG 40(4), 2021,
eqs. 3 and 4 with lambda = 1). A cell in rigid motion attains the minimum, f = 2, whatever its aspect ratio. With the
weight w of its cell (:mod:`meshdeform_core.repair.region`), a sample has the energy

    share (w f + cubic p^3 / (1 + p / 4)) + elastic w^q / 2 |A - A_reference|^2,    p = f - 2

where A_reference is the matrix of the same cell in another grid. The cubic term emphasises the largest f; it grows only
like p^2 where f is very large, lest it flatten the first cells at walls. The elastic term ties the grid to the
reference, at walls more than elsewhere, as w f pulls more there.

Plane grids: :mod:`.plane`. Products with the second derivatives, for derivatives of the minimum:
:mod:`meshdeform_core.repair.energy`.
"""
