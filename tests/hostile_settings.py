"""Settings that would run code if a parser built what they name."""

import copy
import json

LINEAR = {"class_path": "torch.nn.Linear", "init_args": {"in_features": 2, "out_features": 2}}


def small_checkpoint():
    """What the checkpoint of a small module holds, with weights of zero."""
    import lightning as L

    from torch_geometric_tactile.nn import TactileFNN
    from torch_geometric_tactile.predictor._content import model_entry
    from torch_geometric_tactile.training import TactileModule

    module = TactileModule(TactileFNN(4, 2, widths=(3,), pools=(1,)))
    return {
        "pytorch-lightning_version": L.__version__,
        "state_dict": {name: 0 * value for name, value in module.state_dict().items()},
        "module": {"arguments": module.arguments(), **model_entry(module.model, None)},
        "epoch": 0,
        "global_step": 0,
    }


def payload(mark):
    return {
        "class_path": "torch.fx.graph_module.reduce_graph_module",
        "init_args": {
            "body": {"_code": "pass", "__dict__": {}},
            "import_block": f"import pathlib\npathlib.Path({str(mark)!r}).touch()\n",
        },
    }


def hidden(mark):
    """The payload in each place and form in which a parser may find it."""
    call = payload(mark)
    text = json.dumps(call)
    nested = copy.deepcopy(LINEAR)
    nested["init_args"]["bias"] = call
    listed = copy.deepcopy(LINEAR)
    listed["init_args"]["bias"] = [{"a": [call]}]
    unknown = {**LINEAR, "dict_kwargs": {"bias": call}}
    return {
        "model": {"model": call},
        "nested": {"model": nested},
        "list": {"model": listed},
        "dict_kwargs": {"model": unknown},
        "optimizer": {"model": LINEAR, "optimizer": call},
        "scheduler": {"model": LINEAR, "lr_scheduler": call},
        "other": {"model": LINEAR, "class_weights": call},
        "text": {"model": text},
        "optimizer text": {"model": LINEAR, "optimizer": text},
        "nested text": {"model": {"class_path": "torch.nn.Linear", "init_args": {"bias": text}}},
        "escaped text": {
            "model": {
                "class_path": "torch.nn.Linear",
                "init_args": {"bias": text.replace("class_path", "class\\u005fpath")},
            }
        },
        # Joined by YAML, which takes an escaped line break out of a quoted key.
        **{
            f"folded text {ord(line_end):x}": {
                "model": {
                    "class_path": "torch_geometric.nn.GAE",
                    "init_args": {
                        "encoder": text.replace('"class_path"', f'? "class_\\{line_end}path" ')
                    },
                }
            }
            for line_end in "\r\n\x85\u2028\u2029"
        },
        "dotted key": {"model": LINEAR, "optimizer.class_path": call["class_path"]},
        "dotted key inside": {"model": {**LINEAR, "init_args.bias.class_path": "os.getcwd"}},
        "added key": {"model": LINEAR, "lr_scheduler+": call},
        "class": {"_class_path": call["class_path"], **call["init_args"]},
        "instantiator": {"model": LINEAR, "_instantiator": call["class_path"]},
    }
