// Client of "smarttouch live socket:./touch". Run it by: java Client.java ./touch
import java.io.*;
import java.net.*;
import java.nio.channels.*;
import java.util.stream.*;

public class Client {
    static BufferedReader answers;
    static Writer line;

    static String ask(String request, String fields) throws IOException {
        line.write("{\"request\": \"" + request + "\"" + fields + "}\n");
        line.flush();
        return answers.readLine();
    }

    static String one(int k, int electrodes) {
        return IntStream.range(0, electrodes).mapToObj(index -> index == k % electrodes ? "1" : "0")
            .collect(Collectors.joining(",", ", \"pattern\": [", "]"));
    }

    public static void main(String[] arguments) throws Exception {
        var socket = SocketChannel.open(UnixDomainSocketAddress.of(arguments[0]));
        answers = new BufferedReader(Channels.newReader(socket, "UTF-8"));
        line = Channels.newWriter(socket, "UTF-8");
        var electrodes = Integer.parseInt(ask("status", "").replaceAll(".*\"electrodes\": (\\d+).*", "$1"));
        ask("level", ", \"level\": 0.6");
        System.out.println(ask("show", one(27, electrodes) + ", \"seconds\": 0.5"));
        for (int k = 0; k < 30; k++) ask("put", one(k, electrodes));
        System.out.println(ask("status", ""));
        System.out.println(ask("stop", ""));
    }
}
