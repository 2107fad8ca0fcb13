"""The energy of a deformed grid that forbids foldover, its gradient and second derivatives, or their convex part.

At sample points of every cell (corners; in weak hexahedra also the middles of edges, faces and cell) A is the Jacobian
matrix of the map from the undeformed cell to the deformed one, D = det A, and

    f = |A|^2 / (3 chi^(2/3)) + (D^2 + 1) / (2 chi),    chi = (D + sqrt(eps^2 + D^2)) / 2

(Garanzha, Kaporin, Kudryavtseva, Protais, Ray, Sokolov: Foldover-free maps in 50 lines of code, ACM TOG 40(4), 2021,
eqs. 3 and 4 with lambda = 1). A cell in rigid motion has the minimum, 2, whatever its aspect ratio. With the
weight w of its cell (:mod:`meshdeform_core.repair.walls`), a sample has the energy

    share (w f + cubic p^3 / (1 + p / 4)) + elastic / 2 |A - A_reference|^2,    p = f - 2

where A_reference is that of the same cell in another grid. The cubic term makes the largest f count most, without
pressing first cells at walls flat where f is very large; the elastic one ties the grid to the reference.

Plane grids have :mod:`.plane`. Derivatives of the minimum need products with the second derivatives: :mod:`.tangents`.
"""
