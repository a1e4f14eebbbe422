from .campbell_file import read_campbell as read_campbell
from .campbell_file import write_campbell as write_campbell
from .response_file import Responses as Responses
from .response_file import read_responses as read_responses
from .response_file import write_responses as write_responses
from .result_file import Result as Result
