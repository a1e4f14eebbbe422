"""Shows the keywords that a function takes by `**keywords: Unpack[...]`, and explains one by one, as optional."""

import importlib
import inspect

import griffe


class Keywords(griffe.Extension):
    def on_function_instance(self, *, func, **others):
        taken = [item.name for item in func.parameters if "Unpack[" in str(item.annotation)]
        taken = [name for name in taken if f"**{name}" not in func.docstring.value]
        if not taken:
            return
        # the signature of the function itself has them one by one
        item = importlib.import_module(func.module.path)
        for name in func.path.removeprefix(f"{func.module.path}.").split("."):
            item = getattr(item, name)
        for name in taken:
            del func.parameters[name]
        for key in inspect.signature(item).parameters.values():
            if key.name not in func.parameters:
                known = {"annotation": str(key.annotation), "kind": griffe.ParameterKind.keyword_only}
                func.parameters.add(griffe.Parameter(key.name, default="None", **known))
