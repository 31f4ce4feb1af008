"""The exceptions of the package. Each message is one sentence: what is wrong, where, the value found, what to do."""


class AmrpicError(Exception):
    """Base of all errors that the package raises on purpose."""


class SceneError(AmrpicError):
    """A scene asks for something that cannot be."""


class InputError(AmrpicError):
    """A file or an array given to the package cannot be used."""


class HierarchyError(AmrpicError):
    """A hierarchy of boxes is refused."""


class ParticleError(AmrpicError):
    """Particles are in a state that no step can start from."""


class SolverError(AmrpicError):
    """The potential could not be found, or does not exist."""


class OutputError(AmrpicError):
    """Something could not be written."""
