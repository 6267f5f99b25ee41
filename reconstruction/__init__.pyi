from reconstruction.reconstructed_session import open_session as open_session
from reconstruction.session.conditions import Condition as Condition
