// Take the body of matrices.py into Project Chrono as a ChModalAssembly: body arm
#include <fstream>
#include <string>
#include <vector>

#include "chrono/fea/ChMesh.h"
#include "chrono/fea/ChNodeFEAxyzrot.h"
#include "chrono/physics/ChSystemNSC.h"
#include "chrono/solver/ChDirectSolverLS.h"
#include "chrono_modal/ChModalAssembly.h"
#include "chrono_modal/ChModalSolverUndamped.h"
#include "chrono_modal/ChUnsymGenEigenvalueSolver.h"

using namespace chrono;
using namespace chrono::fea;
using namespace chrono::modal;

static ChSparseMatrix Read(const std::string& name, int n) {
    std::ifstream file(name);
    std::vector<Eigen::Triplet<double>> entries;
    int i, j;
    double value;
    while (file >> i >> j >> value)
        entries.emplace_back(i, j, value);
    ChSparseMatrix matrix(n, n);
    matrix.setFromTriplets(entries.begin(), entries.end());
    return matrix;
}

int main(int argc, char* argv[]) {
    const std::string stem = argc > 1 ? argv[1] : "arm";
    std::ifstream file(stem + "_nodes.txt");
    int n, modes, inside, count;
    file >> n >> modes >> inside >> count;

    ChSystemNSC sys;
    sys.SetSolver(chrono_types::make_shared<ChSolverSparseQR>());
    auto body = chrono_types::make_shared<ChModalAssembly>();
    sys.Add(body);
    body->SetReductionType(ChModalAssembly::ReductionType::CRAIG_BAMPTON);
    body->SetInternalNodesUpdate(false);  // internal nodes have no place

    // interface nodes, to which links, loads and bodies are attached
    auto boundary = chrono_types::make_shared<ChMesh>();
    body->AddMesh(boundary);
    std::vector<std::shared_ptr<ChNodeFEAxyzrot>> nodes;
    for (int k = 0; k < count; k++) {
        double x, y, z;
        file >> x >> y >> z;
        nodes.push_back(chrono_types::make_shared<ChNodeFEAxyzrot>(ChFrame<>(ChVector3d(x, y, z))));
        boundary->AddNode(nodes.back());
    }
    // nodes that carry the modal coordinates
    auto internal = chrono_types::make_shared<ChMesh>();
    body->AddInternal(internal);
    for (int k = 0; k < inside; k++)
        internal->AddNode(chrono_types::make_shared<ChNodeFEAxyzrot>());

    sys.Setup();
    sys.Update(UpdateFlags::UPDATE_ALL);
    ChSparseMatrix M = Read(stem + "_M.txt", n), K = Read(stem + "_K.txt", n), Cq(0, n);
    auto eigen = chrono_types::make_shared<ChUnsymGenEigenvalueSolverKrylovSchur>();
    ChModalSolverUndamped<ChUnsymGenEigenvalueSolverKrylovSchur> solver(modes, 1e-4, true, false, eigen);
    body->DoModalReduction(M, K, Cq, solver, ChModalDampingRayleigh(0.0, 1e-6));  // alpha, beta of the job

    // links and loads at nodes[k], then sys.DoStepDynamics(step)
    return 0;
}
