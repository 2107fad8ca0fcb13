"""The polyMesh of OpenFOAM: faces, their owners and neighbours, patches and points."""
