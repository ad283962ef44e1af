"""A server with those paths of the Hugging Face Hub that a push and a download ask for."""

import base64
import hashlib
import json
import re
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread

OWNER = "hf_owner"  # a token of the account "user"
WRITER = "hf_writer"  # one that may write, and create nothing


class Repository:
    """Files by revision; a commit has the number of its place."""

    def __init__(self, private):
        self.private = private
        self.branches = {"main": {}}
        self.commits = {"main": commit_hash(0)}
        self.messages = []


def commit_hash(number):
    return f"{number + 1:040x}"


class Hub:
    """The repositories, and how files are uploaded: "regular" within the commit, or "lfs"."""

    def __init__(self):
        self.repositories = {}
        self.objects = {}
        self.upload_mode = "regular"
        self.requests = []

    def commit(self, repo, revision, lines):
        files = dict(repo.branches[revision])
        for line in lines:
            value = line["value"]
            if line["key"] == "file":
                files[value["path"]] = base64.b64decode(value["content"])
            elif line["key"] == "lfsFile":
                files[value["path"]] = self.objects[value["oid"]]
            else:
                repo.messages.append(value["summary"])
        repo.branches[revision] = files
        repo.commits[revision] = commit_hash(len(repo.messages))
        return repo.commits[revision]


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def log_message(self, *arguments):
        pass

    @property
    def hub(self):
        return self.server.hub

    def answer(self, status, content=b"", headers=None):
        if not isinstance(content, bytes):
            content = json.dumps(content).encode()
        self.send_response(status)
        for name, value in {"Content-Length": str(len(content)), **(headers or {})}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    def refuse(self, status, code):
        self.answer(status, {"error": code}, {"X-Error-Code": code, "X-Error-Message": code})

    def handle_request(self):
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        self.hub.requests.append(f"{self.command} {self.path}")
        for method, pattern, action in PATHS:
            match = re.fullmatch(pattern, self.path.partition("?")[0])
            if match and method == self.command:
                return action(self, body, *match.groups())
        return self.refuse(404, "NotFound")

    do_GET = do_HEAD = do_POST = do_PUT = handle_request  # noqa: N815

    def has_token(self, *tokens):
        return self.headers.get("Authorization") in [f"Bearer {token}" for token in tokens]

    def repository(self, name, to_write=False):
        """The repository, or nothing where the answer has been an error."""
        repo = self.hub.repositories.get(name)
        if repo is None or (repo.private and not self.has_token(OWNER, WRITER)):
            return self.refuse(401, "RepoNotFound")
        if to_write and not self.has_token(OWNER, WRITER):
            return self.refuse(403, "Forbidden")
        return repo

    def create(self, body):
        asked = json.loads(body)
        name = f"{asked.get('organization') or 'user'}/{asked['name']}"
        if not self.has_token(OWNER) or not name.startswith("user/"):
            return self.refuse(403, "Forbidden")
        if name in self.hub.repositories:
            return self.answer(409, {"url": f"{self.server.url}/{name}"})
        private = asked.get("visibility") == "private" or asked.get("private") is True
        self.hub.repositories[name] = Repository(private)
        return self.answer(200, {"url": f"{self.server.url}/{name}"})

    def validate(self, body):
        text = json.loads(body)["content"]
        return self.answer(200 if text.startswith("---\n") else 400, {"errors": [], "warnings": []})

    def describe(self, body, name, revision="main"):
        repo = self.repository(name)
        if repo is not None:
            self.answer(200, {"id": name, "sha": repo.commits[revision]})

    def branch(self, body, name, revision):
        repo = self.repository(name, to_write=True)
        if repo is not None and revision in repo.branches:
            self.answer(409, {"error": "Reference already exists"})
        elif repo is not None:
            repo.branches[revision] = dict(repo.branches["main"])
            repo.commits[revision] = repo.commits["main"]
            self.answer(200, {})

    def preupload(self, body, name, revision):
        if self.repository(name, to_write=True) is None:
            return
        files = json.loads(body)["files"]
        modes = dict.fromkeys((file["path"] for file in files), self.hub.upload_mode)
        modes["README.md"] = "regular"
        self.answer(
            200,
            {
                "files": [
                    {"path": f["path"], "uploadMode": modes[f["path"]], "shouldIgnore": False}
                    for f in files
                ]
            },
        )

    def batch(self, body, name):
        objects = json.loads(body)["objects"]
        for item in objects:
            item["actions"] = {"upload": {"href": f"{self.server.url}/lfs/{item['oid']}"}}
        self.answer(200, {"objects": objects, "transfer": "basic"})

    def upload(self, body, oid):
        assert hashlib.sha256(body).hexdigest() == oid
        self.hub.objects[oid] = body
        self.answer(200)

    def commit(self, body, name, revision):
        repo = self.repository(name, to_write=True)
        if repo is not None:
            lines = [json.loads(line) for line in body.splitlines()]
            oid = self.hub.commit(repo, revision, lines)
            url = f"{self.server.url}/{name}/commit/{oid}"
            self.answer(200, {"commitUrl": url, "commitOid": oid})

    def download(self, body, name, revision, path):
        repo = self.repository(name)
        if repo is None:
            return None
        if revision not in repo.branches:
            return self.refuse(404, "RevisionNotFound")
        head = {"X-Repo-Commit": repo.commits[revision]}
        content = repo.branches[revision].get(path)
        if content is None:
            head |= {"X-Error-Code": "EntryNotFound", "X-Error-Message": "EntryNotFound"}
            return self.answer(404, {}, head)
        head["ETag"] = f'"{hashlib.sha256(content).hexdigest()}"'
        return self.answer(200, content, head)


PATHS = (
    ("POST", "/api/repos/create", Handler.create),
    ("POST", "/api/validate-yaml", Handler.validate),
    ("GET", "/api/models/([^/]+/[^/]+)", Handler.describe),
    ("GET", "/api/models/([^/]+/[^/]+)/revision/([^/]+)", Handler.describe),
    ("POST", "/api/models/([^/]+/[^/]+)/branch/([^/]+)", Handler.branch),
    ("POST", "/api/models/([^/]+/[^/]+)/preupload/([^/]+)", Handler.preupload),
    ("POST", "/api/models/([^/]+/[^/]+)/commit/([^/]+)", Handler.commit),
    ("POST", r"/([^/]+/[^/]+)\.git/info/lfs/objects/batch", Handler.batch),
    ("PUT", "/lfs/([0-9a-f]+)", Handler.upload),
    ("HEAD", "/([^/]+/[^/]+)/resolve/([^/]+)/(.+)", Handler.download),
    ("GET", "/([^/]+/[^/]+)/resolve/([^/]+)/(.+)", Handler.download),
)


@contextmanager
def hub_server():
    """Yields the hub and its address."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.hub, server.url = Hub(), f"http://127.0.0.1:{server.server_port}"
    thread = Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield server.hub, server.url
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
