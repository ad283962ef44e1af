"""Settings that would run code if a parser built what they name."""

import copy

LINEAR = {"class_path": "torch.nn.Linear", "init_args": {"in_features": 2, "out_features": 2}}


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
    text = str(call).replace("'", '"')
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
        "dotted key": {"model": LINEAR, "optimizer.class_path": call["class_path"]},
        "dotted key inside": {"model": {**LINEAR, "init_args.bias.class_path": "os.getcwd"}},
        "added key": {"model": LINEAR, "lr_scheduler+": call},
        "class": {"_class_path": call["class_path"], **call["init_args"]},
        "instantiator": {"model": LINEAR, "_instantiator": call["class_path"]},
    }
