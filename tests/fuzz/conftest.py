# Programs and their parts, which need extras: nothing in them is a test.
collect_ignore_glob = ["[!t]*.py", "t[!e]*.py", "te[!s]*.py"]
