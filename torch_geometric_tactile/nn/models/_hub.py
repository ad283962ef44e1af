r"""Models in a folder, or on the Hugging Face Hub."""

import json
from collections.abc import Mapping
from inspect import Parameter, signature
from pathlib import Path
from typing import Any, Self

import torch
from torch import Tensor
from torch.nn import Module
from torch_geometric.nn import model_hub
from torch_geometric.nn.model_hub import PyGModelHubMixin

from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data._allocation_limit import AllocationLimit
from torch_geometric_tactile.data._torch_file import read_torch_file, write_torch_file
from torch_geometric_tactile.nn.models._taxels import portable_layout
from torch_geometric_tactile.sensors import TaxelLayout

_CARD = """---
{{ card_data }}
---

# {{ name }}

    {{ text }}

    from torch_geometric_tactile.nn import {{ name }}
    model = {{ name }}.from_pretrained(...)  # this repository or folder
"""


class TactileHubMixin(PyGModelHubMixin):
    r"""Saves a model with the arguments of its constructor in a folder or on the Hugging Face Hub,
    and loads it.

    It is a :class:`torch_geometric.nn.model_hub.PyGModelHubMixin` for models with constructors of
    their own: it keeps all arguments, lists and dictionaries among them, in their order, and
    loads weights strictly. The folder holds :obj:`config.json`, :obj:`model.pth` and a model card.

    Arguments must be plain values, tensors or a layout; of a layout file, the contents are saved.
    Of a module (an encoder of edge features), only the name is saved: give the module to
    :meth:`from_pretrained` again.

    Examples:
        >>> from torch_geometric_tactile.nn import TactileGCN
        >>> model = TactileGCN(24, inputs=("tactile", "position"))
        >>> isinstance(model, PyGModelHubMixin)
        True
        >>> model.save_pretrained("gcn")  # doctest: +SKIP
        >>> model = TactileGCN.from_pretrained("gcn")  # doctest: +SKIP
    """

    _hub_arguments: dict[str, Any]

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        r"""Keeps the arguments."""
        # Not as `huggingface_hub` does, which keeps what its JSON encoder happens to know.
        self = object.__new__(cls)
        bound = signature(cls.__init__).bind_partial(self, *args, **kwargs)
        bound.apply_defaults()
        arguments = dict(list(bound.arguments.items())[1:])
        for parameter in bound.signature.parameters.values():
            if parameter.kind is Parameter.VAR_KEYWORD:
                arguments.update(arguments.pop(parameter.name))
            elif parameter.kind is Parameter.VAR_POSITIONAL and not arguments[parameter.name]:
                del arguments[parameter.name]
        if "layout" in arguments:
            arguments["layout"] = portable_layout(arguments["layout"])
        self._hub_arguments = arguments
        return self

    def save_pretrained(self, save_directory: PathLike, **kwargs: Any) -> str | None:
        r"""Saves the model in a folder.

        Args:
            save_directory (str or PathLike): The folder.
            **kwargs (optional): Further arguments of
                :meth:`huggingface_hub.ModelHubMixin.save_pretrained`, such as
                :obj:`push_to_hub=True` and :obj:`repo_id`.

        Raises:
            ImportError: If :obj:`huggingface_hub` is missing.
            ValueError: If an argument of the model cannot be saved.
        """
        _check_installed()
        _plain(self._hub_arguments)
        url: str | None = super(PyGModelHubMixin, self).save_pretrained(
            Path(save_directory), **kwargs
        )
        return url

    @classmethod
    def from_pretrained(cls, pretrained_model_name_or_path: PathLike, **kwargs: Any) -> Self:
        r"""Loads a model from a folder or from the Hub, in evaluation mode.

        Args:
            pretrained_model_name_or_path (str or PathLike): The folder, or the name of the model
                on the Hub.
            **kwargs (optional): Arguments of the model that replace the saved ones,
                :obj:`map_location` for the weights, and further arguments of
                :meth:`huggingface_hub.ModelHubMixin.from_pretrained`, such as :obj:`revision`.

        Raises:
            FileNotFoundError: If the folder has no model in it.
            ImportError: If :obj:`huggingface_hub` is missing.
            ValueError: If the configuration cannot be read, the weights are damaged, hold more than
                tensors or are not those of the model, or there are arguments that the model does
                not have, as in the folders of older versions of this package.
        """
        _check_installed()
        name = str(pretrained_model_name_or_path)
        try:
            model: Self = super(PyGModelHubMixin, cls).from_pretrained(name, **kwargs)
        except ImportError:
            raise
        except OSError as error:
            # Of the folder itself, or of the network; otherwise of a file that it names.
            if not Path(name).is_dir() or name in str(error):
                raise
            raise ValueError(f"'{name}' is no {cls.__name__} that can be read: {error}") from error
        # Whatever the constructor and PyTorch raise for a damaged or strange configuration.
        except Exception as error:
            kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
            text = " ".join(f"{kind}{error}".split())
            raise ValueError(f"'{name}' is no {cls.__name__} that can be read: {text}") from error
        return model

    def generate_model_card(self, *args: Any, **kwargs: Any) -> Any:
        r"""Returns the card of the model, a :class:`huggingface_hub.ModelCard`."""
        from huggingface_hub import ModelCard, ModelCardData

        data = ModelCardData(library_name="torch-geometric-tactile", tags=model_hub.TAGS)
        return ModelCard.from_template(
            data, template_str=_CARD, name=type(self).__name__, text=repr(self), **kwargs
        )

    def _save_pretrained(self, save_directory: Path) -> None:
        weights = self.state_dict()
        write_torch_file(weights, save_directory / model_hub.MODEL_WEIGHTS_NAME)
        # Written here, because `huggingface_hub` would sort the keys: the order of the threads is
        # that of their features.
        text = json.dumps(_plain(self._hub_arguments), indent=2)
        with atomic_path(save_directory / model_hub.CONFIG_NAME) as temporary:
            temporary.write_text(text + "\n", encoding="utf-8")

    @classmethod
    def _from_pretrained(
        cls,
        *,
        model_id: str,
        map_location: Any = "cpu",
        revision: str | None = None,
        cache_dir: PathLike | None = None,
        force_download: bool = False,
        local_files_only: bool = False,
        token: str | bool | None = None,
        config: Mapping[str, Any] | None = None,
        **arguments: Any,
    ) -> Self:
        name = model_hub.MODEL_WEIGHTS_NAME
        path = Path(model_id) / name
        if not Path(model_id).is_dir():
            path = model_hub.hf_hub_download(
                repo_id=model_id,
                filename=name,
                revision=revision,
                cache_dir=cache_dir,
                force_download=force_download,
                local_files_only=local_files_only,
                token=token,
            )
        elif not path.is_file():
            raise FileNotFoundError(f"'{path}' is missing: write it with 'save_pretrained'")
        # `huggingface_hub` leaves out arguments of `config` that it does not find in the signature.
        known = _argument_names(cls)
        unknown = [key for key in {**(config or {}), **arguments} if key not in known]
        if unknown:
            raise ValueError(
                f"{cls.__name__} has no argument '{unknown[0]}', only {sorted(known)}: if "
                f"'{model_id}' was saved by an older version of this package, make the model with "
                "today's arguments and load its 'model.pth' into it"
            )
        if isinstance(arguments.get("layout"), dict):
            arguments["layout"] = TaxelLayout.from_dict(arguments["layout"])
        device = torch.device(map_location)
        weights = read_torch_file(path, device)
        with AllocationLimit(weights.values() if isinstance(weights, Mapping) else ()):
            model: Any = cls(**arguments)
        model.load_state_dict(weights)
        model.to(device).eval()
        return model


def _argument_names(cls: type) -> set[str]:
    # Of the constructor, and where it takes `**kwargs` of that of the next class.
    names: set[str] = set()
    for base in cls.__mro__:
        if "__init__" in vars(base):
            parameters = list(signature(vars(base)["__init__"]).parameters.values())[1:]
            names |= {p.name for p in parameters if p.kind is not Parameter.VAR_KEYWORD}
            if all(p.kind is not Parameter.VAR_KEYWORD for p in parameters):
                break
    return names


def _check_installed() -> None:
    if model_hub.hf_hub_download is None:
        raise ImportError(
            "saved models need 'huggingface_hub': pip install \"torch-geometric-tactile[hub]\""
        )


def _plain(value: Any, name: str = "") -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item, name or str(key)) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item, name) for item in value]
    if isinstance(value, Tensor):
        return value.tolist()
    if isinstance(value, TaxelLayout):
        return value.to_dict()
    if isinstance(value, Module):
        return {"module": str(value)}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise ValueError(
        f"'{name}' must be plain values, a tensor or a layout to be saved "
        f"(got {type(value).__name__})"
    )
