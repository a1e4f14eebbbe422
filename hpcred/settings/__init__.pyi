from .job_file import Job as Job
from .job_file import read_job as read_job
from .machine_file import MachineJob as MachineJob
from .machine_file import read_machine as read_machine
from .source import Source as Source
