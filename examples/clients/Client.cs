// Client of "smarttouch live socket:./touch". Run it by: mcs Client.cs && mono Client.exe ./touch
// In .NET, use this file as Program.cs of a project made by "dotnet new console".
using System;
using System.IO;
using System.Linq;
using System.Net.Sockets;
using System.Text.RegularExpressions;

class Client
{
    static StreamReader answers;
    static StreamWriter line;

    static string Ask(string request, string fields = "")
    {
        line.Write("{\"request\": \"" + request + "\"" + fields + "}\n");
        line.Flush();
        return answers.ReadLine();
    }

    static string One(int k, int electrodes) =>
        ", \"pattern\": [" + string.Join(",", Enumerable.Range(0, electrodes).Select(index => index == k % electrodes ? 1 : 0)) + "]";

    static void Main(string[] arguments)
    {
        var socket = new Socket(AddressFamily.Unix, SocketType.Stream, ProtocolType.Unspecified);
        socket.Connect(new UnixDomainSocketEndPoint(arguments[0]));
        var stream = new NetworkStream(socket);
        answers = new StreamReader(stream);
        line = new StreamWriter(stream);
        var electrodes = int.Parse(Regex.Match(Ask("status"), "\"electrodes\": (\\d+)").Groups[1].Value);
        Ask("level", ", \"level\": 0.6");
        Console.WriteLine(Ask("show", One(27, electrodes) + ", \"seconds\": 0.5"));
        for (var k = 0; k < 30; k++) Ask("put", One(k, electrodes));
        Console.WriteLine(Ask("status"));
        Console.WriteLine(Ask("stop"));
    }
}
