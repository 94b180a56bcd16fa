"""Sentences of four languages, put together from words and patterns; equal seeds, equal ones."""

import random

ENGLISH = {
    "who": "The child|My old neighbor|A blind reader|Anna Miller|The teacher|Everyone|Dr. Brown|"
    "Our friend Tom|The U.S. team|Mr. O'Neil|The café owner|She|He|The whole family|A young doctor|"
    "The people next door|Professor Knowles|The NASA engineer|José|Somebody",
    "does": "reads|knows|found|can touch|never forgets|would rather have|brought|is looking for|"
    "doesn't like|asked about|wrote|should receive|has always had|understands|gave away|"
    "will not spend|kept|dreams of|paid for|remembers",
    "what": "the blue book|a letter from London|every word of it|the quick brown fox|"
    "good bread with butter|an e-mail|the red-haired cat|many questions|the first chapter|"
    "a glass of water|the touch of paper|nothing at all|those wonderful children|"
    "the knowledge of ages|half of the money|a well-known story|his mother's garden|BRAILLE|"
    "the SMALL print|McDonald's farm|the naïve painter|his résumé",
    "where": "in the garden|at home|on Friday morning|under the bridge|before the meeting|"
    "near St. John's|without help|behind the great house|for the first time|through the night|"
    "in New York|after lunch|with both hands|beyond the mountains|at the doctor's|"
    "against the wind|this year|together|as quickly as possible|because of the rain",
    "number": "{n} times|at {h}:{mm}|for ${n}.{mm}|page {n}|on {d} May {y}|in {y}|"
    "{n},{nnn} of them|{n}% of it|{n} km away|room {n}b|£{n}|"
    "{n}-{m}|the {n}th of June|flat {n}A|{n}.5 hours",
}  # fmt: skip
_ENGLISH_PATTERNS = (
    "{who} {does} {what} {where}.", "{who} {does} {what}, {number}.", "Where is {what}?",
    '"{who} {does} {what}," said Mary.', "{who} {does} {what} ({number}) {where}!",
    "{who} {does} {what}; {who} {does} {what}.", "Is it true that {who} {does} {what} {where}?",
    "{who}: {what} {where}.", "Well, {who} {does} {what} - {number}.", "I can't say {where}.",
    "You, and only you, {does} {what}!", "{where}, {who} {does} {what}.", "PLEASE READ {what}.",
    "DO NOT OPEN THE DOOR {number}!", "As for {what}: {number} [see {what}].",
    "Don't! {who} {does} it.",
)  # fmt: skip

GERMAN = {
    "who": "Das Kind|Meine Großmutter|Der alte Schäfer|Frau Müller|Ein Bäcker aus Köln|Jürgen|"
    "Die schöne Königin|Unser Nachbar|Der Schüler|Die Ärztin|Herr Weiß|Niemand|Der Fährmann",
    "does": "liest|findet|hört|kennt|schreibt|vergisst|sucht|erklärt|mag|verkauft|grüßt|überprüft|"
    "träumt von|spricht über|wünscht sich|beschreibt|zählt",
    "what": "das blaue Buch|viele Briefe|den langen Weg|jede Straße|schöne Blumen|süße Äpfel|"
    "die Übung|frisches Brot|ein großes Haus|den Schlüssel|die alte Brücke|zwölf Eier|nichts|"
    "das Fußballspiel|die Geschichte|einen Stuhl|das Mädchen|heiße Milch|die Zeitung",
    "where": "im Garten|am frühen Morgen|ohne Hilfe|vor dem Haus|hinter den Bäumen|in München|"
    "über Nacht|nach der Schule|auf der Straße|unter der Brücke|zum ersten Mal|gegen Abend|"
    "mit beiden Händen|während des Gesprächs|bei schlechtem Wetter",
    "number": "{n} Mal|um {h}:{mm} Uhr|Seite {n}|im Jahr {y}|nach {n} Tagen|für {n},{mm} Euro",
}
_GERMAN_PATTERNS = (
    "{who} {does} {what} {where}.", "{who} {does} {what}, {number}.", "Wo ist {what}?",
    "Ich weiß, dass {who} {what} {where} {does}.", "„{who} {does} {what}“, sagte Paul.",
    "{who} {does} {what} und {who} {does} {what}!", "Ist es wahr? {who} {does} {what}.",
    "{who}: {what} {where}.", "Die Tür ({number}) ist offen; {who} {does} {what}.",
)  # fmt: skip

FRENCH = {
    "who": "L’enfant|Ma grand-mère|Le vieux berger|Madame Lefèvre|Un élève|Hélène|La forêt|Où|"
    "Mon frère|Le garçon|Sa sœur|Le maître d’école|Personne|François|Noël|L’aïeule",
    "does": "lit|trouve|écoute|connaît|écrit|oublie|cherche|préfère|achète|reçoit|espère|a vendu|"
    "n’aime pas|voudrait|rêve de|s’intéresse à|dessine",
    "what": "le livre bleu|une lettre|la fenêtre|le cœur|des œufs|un café très chaud|la leçon|"
    "ses deux mains|l’été|la même histoire|du pain|le théâtre|un château|la clé|rien du tout|"
    "l’hôtel|une pièce de monnaie|où aller|le maïs",
    "where": "dans le jardin|à Paris|sans aide|après l’école|sous le pont|près de la gare|"
    "pour la première fois|demain matin|là-bas|à côté de l’église|jusqu’à midi|avec joie",
    "number": "{n} fois|à {h} heures|page {n}|en {y}|pour {n},{mm} euros|le {d} août",
}
_FRENCH_PATTERNS = (
    "{who} {does} {what} {where}.", "{who} {does} {what}, {number}.", "Où est {what} ?",
    "« {who} {does} {what} », dit Paul.", "{who} {does} {what} et {who} {does} {what} !",
    "{who} : {what} {where}.", "Ça va ; {who} {does} {what} ({number}).",
)  # fmt: skip

JAPANESE = {
    "who": "わたしわ|ともだちわ|せんせいわ|おかあさんわ|おとーとが|きょーしつの こどもが|いしゃわ|"
    "ぎゅーにゅーやさんわ|しょーねんが|りょこーしゃわ|だれかが|ぴあにすとわ|チェロの せんせいわ",
    "what": "ほんを|てがみを|がっこーの まどを|ちゃわんを|にゅーすを|ジャムと パンを|コーヒーを|"
    "きっぷを|ざっしを|でんしゃの おとを|びょーいんえ いく みちを|ファミリー レストランを|"
    "ヴァイオリンを|しゃしんを|ひゃくえんの りんごを|ティッシュを|ぱんやの みせを|ウィスキーを",
    "does": "よみます|かきました|さがして います|みつけた|しって います|わすれない|ききたい|"
    "かって きます|つくりました|もらった|さわって みる|くらべて ください",
    "where": "あさ はやく|にわで|えきの まえで|きょー|あした|ゆっくり|りょーてで|いつも|そっと|"
    "とーきょーで|どーぶつえんで|みずうみの そばで|はじめて",
    "number": "{n}かい|{n}にん|{n}えんで|{n}がつ {d}にち|{y}ねん|{n},{nnn}えんで|{n}おくえんで|"
    "{n}りんの",
}
_JAPANESE_PATTERNS = (
    "{who} {where} {what} {does}。", "{where}、{who} {what} {does}。", "{who} {what} {does}か？",
    "「{who} {what} {does}。」と いった。", "{who} {number} {what} {does}。",
    "{who} {does}！{who} {does}。",
    "{who}（{where}）{what} {does}。", "{number} {who} {does}。{what} {does}。",
)  # fmt: skip

_LANGUAGES = {
    "english": (ENGLISH, _ENGLISH_PATTERNS), "german": (GERMAN, _GERMAN_PATTERNS),
    "french": (FRENCH, _FRENCH_PATTERNS), "japanese": (JAPANESE, _JAPANESE_PATTERNS),
}  # fmt: skip


def make_sentences(language: str, count: int = 1000, seed: int = 0) -> list[str]:
    """Return different sentences of "english", "german", "french" or "japanese" (kana)."""
    random_ = random.Random(f"{language} {seed}")
    words, patterns = _LANGUAGES[language]
    sentences: dict[str, None] = {}
    while len(sentences) < count:
        sentences[_make(random_, words, random_.choice(patterns))] = None
    return list(sentences)


def _make(random_: random.Random, words: dict[str, str], pattern: str) -> str:
    text = pattern
    while "{" in text:
        before, _, rest = text.partition("{")
        key, _, after = rest.partition("}")
        chosen = random_.choice(words[key].split("|")) if key in words else _digits(random_, key)
        text = before + chosen + after
    return text[0].upper() + text[1:]


def _digits(random_: random.Random, key: str) -> str:
    return {
        "n": str(random_.randrange(2, 1000)), "m": str(random_.randrange(1000, 2000)),
        "nnn": f"{random_.randrange(1000):03}", "mm": f"{random_.randrange(60):02}",
        "h": str(random_.randrange(24)), "d": str(random_.randrange(1, 31)),
        "y": str(random_.randrange(1066, 2100)),
    }[key]  # fmt: skip
