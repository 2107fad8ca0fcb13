"""OpenFOAM: blockMeshDict files, cases, and meshes (polyMesh). :mod:`.case` alone is needed by every run."""
