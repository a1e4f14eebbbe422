from . import analysis as analysis
from . import assembly as assembly
from . import body as body
from . import fe as fe
from . import files as files
from . import laws as laws
from . import loads as loads
from . import model as model
from . import outputs as outputs
from . import readers as readers
from . import reduction as reduction
from . import settings as settings
from . import simulation as simulation
from . import workflows as workflows
from . import writers as writers
from .analysis.bores import find_bores as find_bores
from .analysis.campbell import campbell as campbell
from .analysis.damped_modes import damped_modes as damped_modes
from .analysis.error import relative_error as relative_error
from .analysis.error_check import check_reduced as check_reduced
from .analysis.frequency_response import frequency_response as frequency_response
from .analysis.full_response import full_response as full_response
from .analysis.natural_modes import natural_modes as natural_modes
from .analysis.summary import inspect as inspect
from .body.floating_frame import floating_frame as floating_frame
from .body.node_shapes import node_shapes as node_shapes
from .body.preload import preloaded as preloaded
from .body.stress import stress_modes as stress_modes
from .body.unit_states import geometric_stiffness as geometric_stiffness
from .examples.crank import crank as crank
from .examples.linkage import linkage as linkage
from .examples.solid import solid as solid
from .fe.dofs import Dofs as Dofs
from .files.model_file import read_model as read_model
from .files.model_file import write_model as write_model
from .files.point_store import PointStore as PointStore
from .files.result_file import read_result as read_result
from .files.result_file import write_result as write_result
from .linalg.solvers.settings import Factoring as Factoring
from .linalg.solvers.settings import LinearSolver as LinearSolver
from .model.damping import Caughey as Caughey
from .model.damping import GivenDamping as GivenDamping
from .model.damping import ModalDamping as ModalDamping
from .model.damping import NoDamping as NoDamping
from .model.damping import Rayleigh as Rayleigh
from .model.damping import Structural as Structural
from .model.frames import Buckens as Buckens
from .model.frames import Chord as Chord
from .model.frames import NoFrame as NoFrame
from .model.frames import Tangent as Tangent
from .model.from_pymor import from_pymor as from_pymor
from .model.interfaces.nodes import Interface as Interface
from .model.interfaces.nodes import Nodes as Nodes
from .model.material_stiffness import material_stiffness as material_stiffness
from .model.parameters.definitions import Parameter as Parameter
from .model.parameters.definitions import Term as Term
from .model.parameters.parametric_model import ParametricModel as ParametricModel
from .model.rotation import rotation_terms as rotation_terms
from .model.second_order_model import SecondOrderModel as SecondOrderModel
from .model.viscoelastic import Viscoelastic as Viscoelastic
from .parallel.failures import ComputationError as ComputationError
from .parallel.failures import InputError as InputError
from .parallel.failures import agreed as agreed
from .parallel.progress import Progress as Progress
from .parallel.startup import start as start
from .reduction.components.craig_bampton import CraigBampton as CraigBampton
from .reduction.components.krylov import Krylov as Krylov
from .reduction.components.krylov import StaticCorrection as StaticCorrection
from .reduction.components.modes import Modes as Modes
from .reduction.components.second_order_krylov import SecondOrderKrylov as SecondOrderKrylov
from .reduction.irka import IRKA as IRKA
from .reduction.parametric.settings import ParameterSearch as ParameterSearch
from .reduction.reduce import reduce as reduce
from .reduction.result.reduced_model import ReducedModel as ReducedModel
from .reduction.search.goal import Adaptive as Adaptive
from .reduction.settings import Reduction as Reduction
from .simulation.simulation import Simulation as Simulation
from .simulation.simulation import simulate as simulate
from .workflows.assemble import assemble as assemble
from .workflows.assemble import assemble_file as assemble_file
from .workflows.bench import bench as bench
from .workflows.campbell import campbell_file as campbell_file
from .workflows.convert import convert as convert
from .workflows.recover import recover as recover
from .workflows.reduce import reduce_job as reduce_job
from .workflows.report import report_file as report_file
from .workflows.simulate import simulate_file as simulate_file
from .writers.state_space import state_space as state_space

bores = workflows.bores_of_file
collect = workflows.collect_sweep
demo = workflows.run_demo
evaluate = workflows.evaluate_result
example = workflows.write_example
export = workflows.export_result
info = workflows.describe_file
modes = workflows.modes_of_file
paper = workflows.reproduce
plan = workflows.plan_file
response = workflows.response_file
store = workflows.list_store
sweep = workflows.run_sweep

__version__: str
