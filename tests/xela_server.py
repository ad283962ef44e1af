"""Messages as XELA's server sends them."""


def sensor(**changed):
    return {
        "data": "8056,806C,8C3C,7E75,8013,8D36",
        "model": "uSPa22",
        "taxels": 2,
        "integer": [32854, 32876, 35900, 32373, 32787, 36150],
        "calibrated": [0.5, -0.25, 1.0, None, 0.0, 2.0],
        "handedness": "right",
        **changed,
    }


def message(number=7, **changed):
    content = {
        "message": number,
        "time": number / 10,
        "sensors": 1,
        "type": "routine",
        "version": "1.8.0",
        "1": sensor(),
        "sendtime": number / 10 + 0.01,
        **changed,
    }
    return {key: value for key, value in content.items() if value is not ...}
