from .job_file import Job as Job
from .job_file import read_job as read_job
from .source import Source as Source
