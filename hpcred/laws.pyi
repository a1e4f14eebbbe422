from .model.laws.hysteretic import Hysteretic as Hysteretic
from .model.laws.viscoelastic import Fractional as Fractional
from .model.laws.viscoelastic import FractionalKelvinVoigt as FractionalKelvinVoigt
from .model.laws.viscoelastic import Maxwell as Maxwell
