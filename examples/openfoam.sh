#!/bin/sh
# A flow in OpenFOAM on the points of a series: sh examples/openfoam.sh MOVING RUN
#
# MOVING is what `meshdeform series flap/ -c flap.toml --times 0:1:0.25 --variant encoding=ascii -o MOVING` writes, with
# the files of docs/guides/openfoam.md; RUN is a new case. Nothing is compiled: on every patch the field pointLocation
# follows the points of the levels, linearly in between. So every point has to lie on a patch, as in plane grids.
set -e
moving=$1 run=$2
export WM_PROJECT_DIR="${WM_PROJECT_DIR:-/usr/share/openfoam}"
mkdir -p "$run/0" "$run/system" "$run/constant/boundaryData/all"
cp -r "$moving/constant/polyMesh" "$run/constant"

# The points of all levels as lists without a header, the same for all patches.
data=$run/constant/boundaryData
for points in "$moving"/[0-9]*/polyMesh/points; do
    level=${points%/polyMesh/points}
    mkdir -p "$data/all/${level##*/}"
    sed '1,/^}/d' "$points" > "$data/all/${level##*/}/points"
done
sed '1,/^}/d' "$moving/constant/polyMesh/points" > "$data/all/points"
grep -B1 '^    {' "$moving/constant/polyMesh/boundary" | grep -v '[{-]' | while read -r patch; do
    ln -sfn all "$data/$patch"
done

# dictionary FOLDER NAME CLASS: writes one from the text given to it.
dictionary() {
    { echo "FoamFile { version 2.0; format ascii; class $3; object $2; }"; cat; } > "$run/$1/$2"
}
dictionary constant dynamicMeshDict dictionary <<END
dynamicFvMesh dynamicMotionSolverFvMesh;
motionSolverLibs (fvMotionSolvers);
motionSolver displacementLaplacian;
diffusivity uniform;
END
follow='type timeVaryingMappedFixedValue; fieldTableName points; mapMethod nearest; setAverage no; value uniform (0 0 0);'
dictionary 0 pointLocation pointVectorField <<END
dimensions [0 1 0 0 0 0 0];
internalField uniform (0 0 0);
boundaryField { ".*" { $follow } sides { patchType empty; $follow } }
END
dictionary 0 pointDisplacement pointVectorField <<END
dimensions [0 1 0 0 0 0 0];
internalField uniform (0 0 0);
boundaryField { ".*" { type fixedValue; value uniform (0 0 0); } sides { type empty; } }
END
dictionary 0 U volVectorField <<END
dimensions [0 1 -1 0 0 0 0];
internalField uniform (0 0 0);
boundaryField
{
    bottom { type movingWallVelocity; value uniform (0 0 0); }
    top { type slip; }
    ends { type pressureInletOutletVelocity; value uniform (0 0 0); }
    sides { type empty; }
}
END
dictionary 0 p volScalarField <<END
dimensions [0 2 -2 0 0 0 0];
internalField uniform 0;
boundaryField { ".*" { type zeroGradient; } ends { type totalPressure; p0 uniform 0; value uniform 0; } sides { type empty; } }
END
echo "transportModel Newtonian; nu 0.01;" | dictionary constant transportProperties dictionary
echo "simulationType laminar;" | dictionary constant turbulenceProperties dictionary
dictionary system controlDict dictionary <<END
application pimpleFoam;
startFrom startTime; startTime 0; stopAt endTime; endTime 1; deltaT 0.025;
writeControl adjustableRunTime; writeInterval 0.25; writeFormat ascii; writePrecision 17; timePrecision 6;
END
dictionary system fvSchemes dictionary <<END
ddtSchemes { default Euler; }
gradSchemes { default Gauss linear; }
divSchemes { default Gauss linear; }
laplacianSchemes { default Gauss linear corrected; }
interpolationSchemes { default linear; }
snGradSchemes { default corrected; }
END
dictionary system fvSolution dictionary <<END
solvers
{
    "(p|pcorr|cellDisplacement).*" { solver PCG; preconditioner DIC; tolerance 1e-10; relTol 0; }
    "U.*" { solver smoothSolver; smoother symGaussSeidel; tolerance 1e-10; relTol 0; }
}
PIMPLE { correctPhi yes; nOuterCorrectors 1; nCorrectors 2; nNonOrthogonalCorrectors 1; pRefCell 0; pRefValue 0; }
END
cd "$run"
pimpleFoam
