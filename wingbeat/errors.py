"""The one exception that a person sees: what is wrong, where, and what to do."""


class InputError(Exception):
    """Input that cannot be used. Shown as one line, exit code 1, never a traceback.

    what: the fault in plain words; where: file, key, frame or signal; remedy: what the person can do.
    """

    def __init__(self, what: str, where: object = "", remedy: str = "") -> None:
        self.what, self.where, self.remedy = what, str(where), remedy
        line = f"{self.where}: {what}" if self.where else what
        super().__init__(" ".join(f"{line}; {remedy}".split()) if remedy else " ".join(line.split()))
