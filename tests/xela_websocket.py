"""A WebSocket server in a process of its own, that sends what the test tells it."""

import subprocess
import sys
from contextlib import contextmanager

CLOSE = "CLOSE"


@contextmanager
def server(port=0):
    """Yields its URL, and a function that sends a text to whoever is connected."""
    process = subprocess.Popen(
        [sys.executable, __file__, str(port)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        bufsize=1,
    )

    def send(*texts):
        process.stdin.write("".join(f"{text}\n" for text in texts))
        process.stdin.flush()

    try:
        yield f"ws://127.0.0.1:{int(process.stdout.readline())}", send
    finally:
        process.stdin.close()
        process.kill()
        process.wait()
        process.stdout.close()


def main(port):
    import threading

    from websockets.exceptions import ConnectionClosed
    from websockets.sync.server import serve

    clients = []
    changed = threading.Condition()

    def handle(client):
        with changed:
            clients.append(client)
            changed.notify_all()
        with changed:
            changed.wait_for(lambda: client not in clients)

    with serve(handle, "127.0.0.1", port, compression=None) as running:
        threading.Thread(target=running.serve_forever, daemon=True).start()
        sys.stdout.write(f"{running.socket.getsockname()[1]}\n")
        sys.stdout.flush()
        for line in sys.stdin:
            with changed:
                changed.wait_for(lambda: clients)
                for client in list(clients):
                    if line.strip() == CLOSE:
                        clients.remove(client)
                        changed.notify_all()
                        continue
                    try:
                        client.send(line.rstrip("\n"))
                    except ConnectionClosed:
                        clients.remove(client)


if __name__ == "__main__":
    main(int(sys.argv[1]))
